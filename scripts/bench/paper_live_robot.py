"""The paper's robot under `arpd run` with the uniform policy, at the two ends of a simulated link."""

from __future__ import annotations

import json
import os
import sys
import time
import urllib.request
from contextlib import ExitStack, suppress
from dataclasses import asdict
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.child import Child, ChildError, sent_bytes
from scripts.bench.node import becomes_true
from scripts.bench.paper_cells import SENSORS, TOPICS
from scripts.bench.paper_robot import LEAD_S, PROCESSES, drain, overflows
from scripts.bench.paper_summary import live_summary
from scripts.bench.record import REPO
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink

if TYPE_CHECKING:
    from pathlib import Path

    from scripts.bench.paper_cells import LinkProfile, Turn
    from scripts.netns.namespaces import HostName

#: The paper's program live: Rmin, Dmin and Dmax are the defaults, and no latency budget shortens DEPTH.
CONFIG = {"program": {"policy": "uniform"}, "defaults": {"latency_budget": "none"}}
_STATUS_URL = "http://127.0.0.1:9464/api/v1/status"
_MODULE = "scripts.bench.paper_live_nodes"
_CONFIRM_S, _SETTLE_S = 60.0, 3.0
_WATCH_S = 0.25


class LiveRobot:
    """The robot, its planner and arpd; each turn has processes and a link of its own.

    Parameters
    ----------
    link : its rate, queue and loss
    folder : for the files and logs of the processes
    """

    def __init__(self, link: LinkProfile, folder: Path) -> None:
        self._profile, self._folder = link, folder

    def open(self) -> None:
        """Do nothing: arpd would take processor time from the turns without it."""

    def close(self) -> None:
        """Do nothing; see `open`."""

    def play(self, turn: Turn, *, seconds: float) -> dict[str, Any]:
        """Run one turn and return its figures, measured from when every publisher has confirmed a plan.

        Raises
        ------
        ChildError
            If a process ended, a topic was not matched, or no plan was confirmed.
        """
        with ExitStack() as stack:
            link = stack.enter_context(
                SimLink(
                    f"paper-live-{os.getpid()}-{time.monotonic_ns() % 10**6}",
                    rate_bytes_per_second=self._profile.rate_bytes_per_second,
                    queue_bytes=self._profile.queue_bytes,
                )
            )
            return self._played(stack, link, turn, seconds)

    def _played(self, stack: ExitStack, link: SimLink, turn: Turn, seconds: float) -> dict[str, Any]:
        def child(host: HostName, *argv: str) -> Child:
            made = Child(link, host, _MODULE, *argv)
            stack.callback(made.end)
            return made

        sensors = [child("robot", "sensors", str(number)) for number in range(1, PROCESSES + 1)]
        planner, actuator = child("ceddp", "planner"), child("robot", "actuator")
        self._start(link, "ceddp", "peer", "--interface", link.ceddp.interface, "--name", "ceddp")
        self._start(link, "robot", "run", "--config", str(self._written_config()))
        order = {**asdict(turn.configuration), "turn": 1, "sensors": SENSORS, "seconds": seconds}
        children = [*sensors, planner, actuator]
        for number, each in enumerate(children):
            each.send(**order, folder=str(self._folder), indices=list(range(number, SENSORS, PROCESSES)))
        if not all(each.receive()["matched"] for each in children):
            raise ChildError("not all topics were matched")
        link.set_loss(turn.loss)
        start_ns = time.time_ns() + round(LEAD_S * 1e9)
        for each in sensors:
            each.send(start_ns=start_ns)
        began_s = time.monotonic()
        if not becomes_true(partial(_is_confirmed, link), _CONFIRM_S, poll_s=_WATCH_S):
            raise ChildError(f"not all publishers confirmed a plan in {_CONFIRM_S:.0f} s; logs in {self._folder}")
        confirmed_s = time.monotonic() - began_s
        time.sleep(_SETTLE_S)
        for each in sensors:
            each.send(measure=True)
        for each in sensors:
            each.receive()
        sent_before, overflows_before = sent_bytes(link.robot), sum(map(overflows, link.hosts))
        seen = _watched(link, seconds)
        sent_in_load = sent_bytes(link.robot)
        answers = [each.receive(timeout_s=60.0) for each in sensors]
        drained_s = drain(planner, actuator)
        sent = sent_bytes(link.robot)
        arrived, actuated = planner.ask(stop=True), actuator.ask(stop=True)
        return {
            **live_summary(turn.configuration, seconds, answers, arrived, actuated),
            **_uniform(seen),
            "confirmed_s": confirmed_s,
            "used_ratio": (sent_in_load - sent_before) / seconds / self._profile.rate_bytes_per_second,
            "robot_sent_bytes": sent - sent_before,
            "receive_buffer_overflows": sum(map(overflows, link.hosts)) - overflows_before,
            "drained_s": drained_s,
        }

    def _start(self, link: SimLink, host: HostName, *argv: str) -> None:
        with (self._folder / f"{argv[0]}.log").open("a", encoding="utf-8") as log:
            link.popen(
                host,
                [sys.executable, "-m", "arpd.cli", *argv],
                env={**os.environ, "PYTHONPATH": str(REPO)},
                stderr=log,
                cwd=REPO,
            )

    def _written_config(self) -> Path:
        path = self._folder / "arpd.yaml"
        path.write_text(json.dumps(CONFIG), encoding="utf-8")  # JSON is YAML
        return path


def _status(link: SimLink) -> dict[str, Any] | None:
    """Return arpd's status document, None while it does not answer."""

    def ask() -> dict[str, Any]:
        with urllib.request.urlopen(_STATUS_URL, timeout=3.0) as said:
            document: dict[str, Any] = json.load(said)
            return document

    with suppress(OSError, json.JSONDecodeError):
        return inside(link.robot.namespace, ask)
    return None


def _is_confirmed(link: SimLink) -> bool:
    """Return whether the publishers of all topics confirm a plan."""
    plan = (_status(link) or {}).get("plan")
    return plan is not None and plan["publishers"] == plan["confirmed"] == TOPICS


def _watched(link: SimLink, seconds: float) -> list[dict[str, Any]]:
    """Return the status documents of the next seconds."""
    until_s = time.monotonic() + seconds
    seen = []
    while (left_s := until_s - time.monotonic()) > 0.0:
        if (status := _status(link)) is not None:
            seen.append(status)
        time.sleep(min(_WATCH_S, max(0.0, left_s)))
    return seen


def _uniform(seen: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the medians of N, Rmax and R, and the DEPTH in force, over the measured time.

    Raises
    ------
    ChildError
        If arpd did not answer, or has another policy.
    """
    found = [status["allocation"]["uniform"] for status in seen if status["allocation"]["uniform"]]
    depths = [topic["confirmed"]["depth"] for status in seen for topic in status["topics"] if topic["planned"]]
    if not found or not depths:
        raise ChildError("arpd has no uniform plan")
    return {
        "uniform": {
            "topics": median(each["topics"] for each in found),
            "max_rate_hz": median(each["max_rate_hz"] for each in found),
            "rate_hz": median(each["rate_hz"] for each in found),
            "depth": median(depths),
        }
    }
