"""The robot of `overhead.py`: its processes, and the measurements of them."""

from __future__ import annotations

import json
import math
import os
import sys
import time
import urllib.request
from contextlib import suppress
from dataclasses import dataclass, field
from operator import itemgetter
from statistics import median
from typing import TYPE_CHECKING, Any

import psutil

from arpd.model.errors import ArpdError
from scripts.bench.child import Child
from scripts.bench.node import becomes_true
from scripts.bench.overhead_meter import Meter, Reading, has_cvxpy
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable
    from contextlib import ExitStack
    from pathlib import Path

    from scripts.bench.overhead_cases import Case
    from scripts.bench.overhead_sides import Side
    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import SimLink

STATUS_URL = "http://127.0.0.1:9464/api/v1/status"
_START_S, _FIND_S, _SETTLE_S, _REACT_S = 90.0, 45.0, 40.0, 25.0


class OverheadError(ArpdError):
    """A part of the run did not work."""


@dataclass(slots=True)
class Robot:
    """The processes of one case, on one side.

    Parameters
    ----------
    sink_role : role of the process that reads everything (`scripts.bench.overhead_nodes`)
    placed : called with name and process id of each process on the robot, once it runs
    environment : further variables of arpd's processes, by name

    Attributes
    ----------
    swaps : those begun by each publisher, also of one that arpd has lost sight of
    """

    case: Case
    side: Side
    link: SimLink
    workdir: Path
    stack: ExitStack
    sink_role: str = "sink"
    placed: Callable[[str, int], None] = lambda _name, _pid: None
    environment: Callable[[str], dict[str, str]] = lambda _name: {}
    meter: Meter = field(init=False)
    source: Child = field(init=False)
    sink: Child = field(init=False)
    processes: dict[str, tuple[HostName, subprocess.Popen[Any]]] = field(default_factory=dict)
    swaps: dict[str, int] = field(default_factory=dict)
    _swaps_before: dict[str, int] = field(default_factory=dict)  # those before the last change of the link

    def __post_init__(self) -> None:
        self.meter = Meter(self.link, "source")
        topics = str(len(self.case.topics))
        self.sink, self.source = (
            self._node("ceddp", "sink", self.sink_role, topics),
            self._node("robot", "source", "source", topics),
        )
        for child in (self.sink, self.source):
            child.receive()
        for number, document in enumerate(self.side.accepted(self.case.relays(), "governor")):
            config = self.workdir / f"relay{number}.yaml"
            config.write_text(json.dumps(document), encoding="utf-8")  # JSON is YAML
            argv = ("relay", "--config", str(config), "--node-name", f"relay{number}")
            self._start(f"relay{number}", "robot", *argv)

    def _node(self, host: HostName, name: str, *argv: str) -> Child:
        environment = self.side.environment()
        child = Child(self.link, host, "scripts.bench.overhead_nodes", *argv, environment=environment)
        self.stack.callback(child.end)
        self._keep(name, host, child.process)
        return child

    def _start(self, name: str, host: HostName, *argv: str) -> None:
        with (self.workdir / f"{name}.log").open("w") as log:
            process = self.link.popen(
                host,
                [sys.executable, "-m", "arpd.cli", *argv],
                env={**os.environ, **self.side.environment(), **self.environment(name)},
                stderr=log,
                cwd=self.workdir,
            )
        self._keep(name, host, process)

    def _keep(self, name: str, host: HostName, process: subprocess.Popen[Any]) -> None:
        self.processes[name] = host, process
        if host == "robot":
            self.placed(name, process.pid)

    def start_control(self) -> None:
        """Start `arpd peer` and `arpd run`."""
        self._start("peer", "ceddp", "peer", "--interface", self.link.ceddp.interface, "--name", "ceddp")
        self._start("run", "robot", "run", "--config", str(self.workdir / "relay0.yaml"))

    def status(self) -> dict[str, Any] | None:
        """Return arpd's status document; None while it does not answer.

        Raises
        ------
        OverheadError
            If a process has ended.
        """

        def ask() -> dict[str, Any]:
            with urllib.request.urlopen(STATUS_URL, timeout=5.0) as answer:
                document: dict[str, Any] = json.load(answer)
                return document

        for name, (_, process) in self.processes.items():
            if process.poll() is not None:
                raise OverheadError(f"{name} ended with code {process.returncode}; see {self.workdir}/{name}.log")
        with suppress(OSError, json.JSONDecodeError):
            status = inside(self.link.robot.namespace, ask)
            self.swaps |= {f"{topic['node']} {topic['topic']}": topic["swaps_begun"] for topic in status["topics"]}
            return status
        return None

    def await_carried(self) -> None:
        """Wait until the CEDDP's process is matched with a writer of every topic from the robot.

        Raises
        ------
        OverheadError
            If it is not in time.
        """
        wanted = len(self.case.sensing)
        if not becomes_true(lambda: self.sink.ask(matched=True)["matched"] >= wanted, _START_S, poll_s=0.5):
            found = self.sink.ask(matched=True)["matched"]
            raise OverheadError(f"the relays carry {found} of {wanted} topics after {_START_S:.0f} s")

    def found(self) -> dict[str, Any]:
        """Wait until arpd sees every topic cross the link, and its peer; return their number, and the time it took."""
        return self._reached(
            _FIND_S,
            lambda status: (
                {"found": sum(topic["direction"] != "local" for topic in status["topics"])} if status["peers"] else {}
            ),
        )

    def settled(self) -> dict[str, Any]:
        """Wait until all publishers have confirmed a plan; return how many have one and confirm it, and the times."""
        return self._reached(
            _SETTLE_S,
            lambda status: {"planned": status["plan"]["publishers"], "confirmed": status["plan"]["confirmed"]},
        )

    def _reached(self, most_s: float, count: Callable[[dict[str, Any]], dict[str, int]]) -> dict[str, Any]:
        """Wait until all counts are those of all topics; return the last counts, and the time each one took."""
        wanted, began_s = len(self.case.topics), time.monotonic()
        reached: dict[str, Any] = {}
        while (spent_s := time.monotonic() - began_s) < most_s:
            if (status := self.status()) is not None:
                counts = count(status)
                reached |= counts
                for name, counted in counts.items():
                    if counted >= wanted:
                        reached.setdefault(f"{name}_s", spent_s)
                if counts and all(counted >= wanted for counted in counts.values()):
                    break
            time.sleep(0.5)
        return reached

    def publish(self) -> None:
        """Let the sources publish from now on."""
        for child in (self.source, self.sink):
            child.ask(publish=True)

    def read(self) -> Reading:
        """Return the cost of all processes so far."""
        return self.meter.read({name: (host, process.pid) for name, (host, process) in self.processes.items()})

    def measure(self, phase: str, for_s: float) -> dict[str, Any]:
        """Measure CPU, memory, bytes and samples for a while."""
        status = self.status()
        swaps = sum(self.swaps.values())
        asked = [child.ask() for child in (self.source, self.sink)]
        time.sleep(0.5)  # so that the answers themselves are not measured
        before = self.read()
        time.sleep(for_s)
        after = self.read()
        answered = [child.ask() for child in (self.source, self.sink)]
        return {
            "phase": phase,
            "link_bytes_per_second": self.link.rate_bytes_per_second,
            "load_average": os.getloadavg()[0],
            **_costs(before, after),
            "rss_bytes": {
                name: psutil.Process(process.pid).memory_info().rss for name, (_, process) in self.processes.items()
            },
            "has_cvxpy": any(has_cvxpy(process.pid) for _, process in self.processes.values()),
            **_supply(asked, answered),
            **_paced(status, self.status()),
            "swaps": sum(self.swaps.values()) - swaps,
        }

    def steady(self, for_s: float) -> dict[str, Any]:
        """Return plans, by cause, and swaps of a time in which nothing changes.

        The budget spreads the swaps of the last change over the time after it, one for each topic. A second one flaps.
        """
        causes, swaps = self._causes(), sum(self.swaps.values())
        time.sleep(for_s)
        plans = {cause: count - causes.get(cause, 0) for cause, count in self._causes().items()}
        return {
            "lasted_s": for_s,
            "plans": {cause: count for cause, count in plans.items() if count},
            "swaps": sum(self.swaps.values()) - swaps,
            "most_swaps": max((self.swaps[each] - self._swaps_before.get(each, 0) for each in self.swaps), default=0),
        }

    def _causes(self) -> dict[str, int]:
        return dict((self.status() or {"totals": {"levels": {}}})["totals"]["levels"])

    def planning(self, work: Callable[[], dict[str, Any]], settle_s: float) -> dict[str, Any]:
        """Return what ``work`` finds out about a plan, with discovery and swaps until ``settle_s`` after it."""
        before, swaps = self.read(), self._swaps_begun()
        found = work()
        time.sleep(settle_s)
        after, swaps_then = self.read(), self._swaps_begun()
        return {
            **found,
            "lasted_s": after.at_s - before.at_s,
            "discovery_bytes": after.discovery_bytes - before.discovery_bytes,
            "listener_bytes": after.listener_bytes - before.listener_bytes,
            "swaps": swaps_then - swaps,
        }

    def _swaps_begun(self) -> int:
        """Return the swaps of all publishers until now."""
        self.status()
        return sum(self.swaps.values())

    def react(self, rate: float, quiet_s: float) -> dict[str, Any]:
        """Change the link, and note when price, plan and publishers follow."""
        self.source.ask(watch=True)
        time.sleep(3.0)  # so that it is matched and has received the price
        before, self._swaps_before = self.link.rate_bytes_per_second, dict(self.swaps)
        at_s = time.time()
        self.link.set_rate(rate)
        events: dict[int, dict[str, Any]] = {}
        until_s = time.monotonic() + _REACT_S
        while time.monotonic() < until_s:
            time.sleep(1.0)
            if (status := self.status()) is None:
                continue
            events |= {event["number"]: event for event in status["events"] if event["unix_time_seconds"] > at_s}
            if _is_over(list(events.values()), status, quiet_s):
                break
        prices = self.source.ask(watch=False)["prices"]
        return {"from_bytes_per_second": before, "to_bytes_per_second": rate, **_reaction(at_s, prices, events)}


def _is_over(events: list[dict[str, Any]], status: dict[str, Any], quiet_s: float) -> bool:
    times_s = [event["unix_time_seconds"] for event in events if event["event"] in {"plan", "confirmed"}]
    is_planned = any(event["event"] == "plan" for event in events)
    plan = status["plan"]
    is_quiet = bool(times_s) and status["unix_time_seconds"] - max(times_s) > quiet_s
    return is_planned and is_quiet and plan["confirmed"] == plan["publishers"]


def _reaction(at_s: float, prices: list[tuple[float, float]], events: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """Return the delays of price, plan and confirmation (s); None = never."""
    usual = median([admitted for when_s, admitted in prices if when_s <= at_s] or [math.inf])
    lower = [when_s for when_s, admitted in prices if when_s > at_s and admitted < 0.9 * usual]
    planned = [event["unix_time_seconds"] for event in events.values() if event["event"] == "plan"]
    confirmed = [event["unix_time_seconds"] for event in events.values() if event["event"] == "confirmed"]
    return {
        "price_s": min(lower) - at_s if lower else None,
        "plan_s": min(planned) - at_s if planned else None,
        "plans": len(planned),
        "confirmed_s": max(confirmed) - at_s if confirmed and max(confirmed) > max(planned, default=0.0) else None,
        "refusals": sum(event["event"] == "plan_refused" for event in events.values()),
    }


def _costs(before: Reading, after: Reading) -> dict[str, Any]:
    span_s = after.at_s - before.at_s
    return {
        "span_s": span_s,
        "cpu_share": {name: (after.cpu_s[name] - before.cpu_s[name]) / span_s for name in after.cpu_s},
        "interface_bytes_per_second": (after.interface_bytes - before.interface_bytes) / span_s,
        "control_bytes_per_second": {
            kind: (after.control_bytes[kind] - before.control_bytes[kind]) / span_s for kind in after.control_bytes
        },
        "discovery_bytes_per_second": (after.discovery_bytes - before.discovery_bytes) / span_s,
        "listener_bytes_per_second": (after.listener_bytes - before.listener_bytes) / span_s,
    }


def _supply(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> dict[str, float]:
    return {
        key: sum(account[key] for account in after) - sum(account[key] for account in before)
        for key in ("sent", "expected")
    }


def _paced(before: dict[str, Any] | None, after: dict[str, Any] | None) -> dict[str, float]:
    """Return the fate of the samples offered to arpd's publishers, by their announcements."""
    if before is None or after is None:
        raise OverheadError("arpd run does not answer")

    def grown(count: Callable[[dict[str, Any]], float]) -> float:
        return sum(map(count, after["topics"])) - sum(map(count, before["topics"]))

    ticks = after["totals"]["ticks"] - before["totals"]["ticks"]
    waited_s = after["unix_time_seconds"] - before["unix_time_seconds"]
    return {
        **{key: grown(itemgetter(key)) for key in ("offered", "published", "withheld")},
        "published_bytes_per_second": grown(lambda topic: topic["published"] * topic["payload_bytes"]) / waited_s,
        "ticks": ticks,
        "ticks_late": after["totals"]["ticks_late"] - before["totals"]["ticks_late"],
        "ticks_per_second": ticks / waited_s,
        "plans": after["plan"]["generation"] - before["plan"]["generation"],
    }
