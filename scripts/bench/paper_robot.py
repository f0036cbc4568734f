"""The robot of the paper's experiment and its planner, at the two ends of a simulated link."""

from __future__ import annotations

import math
import os
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.bench.child import Child, ChildError, kernel_count, sent_bytes
from scripts.bench.paper_cells import ARPD, SENSORS
from scripts.bench.paper_summary import summary
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from scripts.bench.paper_cells import LinkProfile, Turn
    from scripts.netns.simlink import Host

QUIET_S = 3.2  # more than a heartbeat, 3 s by default, after which a lost sample is sent again
DRAIN_S = 8.0
LEAD_S = 0.2
_POLL_S = 0.1
PROCESSES = 3  # share the sensors, because publish() holds the GIL
_MODULE = "scripts.bench.paper_nodes"


class Robot:
    """Five processes on a link of their own, from `open` to `close`.

    Parameters
    ----------
    heartbeat : DEFAULT or ARPD, the source of the writers' heartbeat period
    folder : for the files of the processes
    """

    def __init__(self, link: LinkProfile, heartbeat: str, folder: Path) -> None:
        self._profile, self._heartbeat, self._folder = link, heartbeat, folder
        self._turns = 0
        self._stack = ExitStack()

    def open(self) -> None:
        """Make the link and start the processes."""
        with ExitStack() as stack:
            self._link = stack.enter_context(
                SimLink(
                    f"paper-{os.getpid()}-{time.monotonic_ns() % 10**6}",
                    rate_bytes_per_second=self._profile.rate_bytes_per_second,
                    queue_bytes=self._profile.queue_bytes,
                )
            )
            self._sensors = [self._child(stack, "robot", "sensors", str(k)) for k in range(1, PROCESSES + 1)]
            self._actuator = self._child(stack, "robot", "actuator")
            self._planner = self._child(stack, "ceddp", "planner")
            self._stack = stack.pop_all()

    def close(self) -> None:
        """End the processes and remove the link."""
        self._stack.close()

    def play(self, turn: Turn, *, seconds: float) -> dict[str, Any]:
        """Run one turn and return its figures.

        Raises
        ------
        ChildError
            If a process ended, or a topic was not matched.
        """
        self._turns += 1
        order = {
            **asdict(turn.configuration),
            "turn": self._turns,
            "sensors": SENSORS,
            "seconds": seconds,
            "folder": str(self._folder),
        }
        children = [*self._sensors, self._planner, self._actuator]
        for number, child in enumerate(children):
            child.send(**order, indices=list(range(number, SENSORS, PROCESSES)))
        matched = [child.receive()["matched"] for child in children]
        if not all(matched):
            raise ChildError("not all topics were matched")
        self._link.set_loss(turn.loss)  # not before: discovery is no part of the experiment
        hosts = self._link.hosts
        sent_before, overflows_before = self._sent_bytes(), sum(map(overflows, hosts))
        start_ns = time.time_ns() + round(LEAD_S * 1e9)
        for child in self._sensors:
            child.send(start_ns=start_ns)
        answers = [child.receive(timeout_s=60.0 + seconds) for child in self._sensors]
        sent_in_load = self._sent_bytes()
        published = sum(
            Path(sensor["left"]).stat().st_size // 8 for process in answers for sensor in process["sensors"]
        )
        drained_s = drain(self._planner, self._actuator, published=published)
        sent = self._sent_bytes()
        arrived, actuated = self._planner.ask(stop=True), self._actuator.ask(stop=True)
        self._link.set_loss(0.0)
        for child in children:
            child.send(close=True)
        for child in children:
            child.receive()
        return {
            **summary(turn.configuration, seconds, answers, arrived, actuated),
            "used_ratio": (sent_in_load - sent_before) / seconds / self._profile.rate_bytes_per_second,
            "robot_sent_bytes": sent - sent_before,
            "receive_buffer_overflows": sum(map(overflows, hosts)) - overflows_before,
            "drained_s": drained_s,
        }

    def _sent_bytes(self) -> int:
        return sent_bytes(self._link.robot)

    def _child(self, stack: ExitStack, host: Any, *argv: str) -> Child:
        plain = {} if self._heartbeat == ARPD else {"FASTRTPS_DEFAULT_PROFILES_FILE": ""}
        child = Child(self._link, host, _MODULE, *argv, environment=plain)
        stack.callback(child.end)
        return child


def drain(planner: Child, actuator: Child, *, published: float = math.inf) -> float:
    """Wait until all has arrived, for QUIET_S without arrivals, or for DRAIN_S; return the time it took (s).

    Parameters
    ----------
    published : number of samples that should arrive at the planner, ``inf`` = not known
    """
    began_s = changed_s = time.monotonic()
    last = None
    while (now_s := time.monotonic()) < began_s + DRAIN_S:
        at_planner, at_actuator = planner.ask(count=True), actuator.ask(count=True)
        seen = (at_planner["arrived"], at_planner["answered"], at_actuator["arrived"])
        if at_planner["arrived"] >= published and at_actuator["arrived"] >= at_planner["answered"]:
            break
        if seen != last:
            last, changed_s = seen, now_s
        elif now_s - changed_s > QUIET_S:
            break
        time.sleep(_POLL_S)
    return time.monotonic() - began_s


def overflows(host: Host) -> int:
    """Return the number of datagrams that a host dropped because the buffer of their socket was full."""
    return kernel_count(host, "Udp", "RcvbufErrors")
