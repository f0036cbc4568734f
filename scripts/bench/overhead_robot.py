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

from arpd.adapters.ros.runtime import FASTDDS_PROFILE
from arpd.model.errors import ArpdError
from scripts.bench.child import Child
from scripts.bench.node import becomes_true
from scripts.bench.overhead_meter import Meter, Reading, has_cvxpy
from scripts.bench.record import REPO
from scripts.netns.namespaces import inside

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable
    from contextlib import ExitStack
    from pathlib import Path

    from scripts.bench.overhead_cases import Case
    from scripts.netns.namespaces import HostName
    from scripts.netns.simlink import SimLink

STATUS_URL = "http://127.0.0.1:9464/api/v1/status"
_START_S, _SETTLE_S, _REACT_S = 90.0, 40.0, 40.0
_CALM_S = 15.0  # after a rise; a fall within it would double the dwell


class OverheadError(ArpdError):
    """A part of the run did not work, or a figure cannot be true."""


@dataclass(slots=True)
class Robot:
    """The processes of one case."""

    case: Case
    link: SimLink
    workdir: Path
    stack: ExitStack
    meter: Meter = field(init=False)
    source: Child = field(init=False)
    sink: Child = field(init=False)
    processes: dict[str, tuple[HostName, subprocess.Popen[Any]]] = field(default_factory=dict)
    rose_s: float = -_CALM_S

    def __post_init__(self) -> None:
        self.meter = Meter(self.link)
        topics = str(len(self.case.topics))
        self.sink, self.source = self._node("ceddp", "sink", topics), self._node("robot", "source", topics)
        for child in (self.sink, self.source):
            child.receive()
        for number, document in enumerate(self.case.relays()):
            config = self.workdir / f"relay{number}.yaml"
            config.write_text(json.dumps(document), encoding="utf-8")  # JSON is YAML
            argv = ("relay", "--config", str(config), "--node-name", f"relay{number}")
            self._start(f"relay{number}", "robot", *argv)

    def _node(self, host: HostName, role: str, topics: str) -> Child:
        child = Child(self.link, host, "scripts.bench.overhead_nodes", role, topics)
        self.stack.callback(child.end)
        self.processes[role] = host, child.process
        return child

    def _start(self, name: str, host: HostName, *argv: str) -> None:
        with (self.workdir / f"{name}.log").open("w") as log:
            process = self.link.popen(
                host,
                [sys.executable, "-m", "arpd.cli", *argv],
                env={**os.environ, "PYTHONPATH": str(REPO), "FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE)},
                stderr=log,
                cwd=REPO,
            )
        self.processes[name] = host, process

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
            return inside(self.link.robot.namespace, ask)
        return None

    def await_carried(self) -> None:
        """Wait until the relays' logs name every topic."""
        wanted = len(self.case.sensing)
        logs = [self.workdir / f"{name}.log" for name in self.processes if name.startswith("relay")]
        _await(
            lambda: sum(log.read_text(encoding="utf-8").count("relaying /") for log in logs) >= wanted,
            f"the relays do not carry {wanted} topics",
        )

    def await_crossing(self) -> None:
        """Wait until arpd sees every topic cross the link, and receives its peer's reports."""
        wanted = len(self.case.topics)

        def is_seen() -> bool:
            status = self.status()
            return (
                status is not None
                and sum(topic["direction"] != "local" for topic in status["topics"]) >= wanted
                and bool(status["peers"])
            )

        _await(is_seen, f"arpd does not see {wanted} topics cross the link")

    def settled_s(self) -> float | None:
        """Wait until all publishers have confirmed a plan for all of them; return the time (s), None if they do not."""
        wanted, began_s = len(self.case.topics), time.monotonic()
        while (spent_s := time.monotonic() - began_s) < _SETTLE_S:
            plan = (self.status() or {}).get("plan")
            if plan is not None and plan["publishers"] >= wanted and plan["confirmed"] == plan["publishers"]:
                return spent_s
            time.sleep(0.5)
        return None

    def publish(self) -> None:
        """Let the sources publish from now on."""
        for child in (self.source, self.sink):
            child.ask(publish=True)

    def measure(self, phase: str, for_s: float) -> dict[str, Any]:
        """Measure CPU, memory, bytes and samples for a while."""
        has_control = "run" in self.processes
        status = self.status() if has_control else None
        asked = [child.ask() for child in (self.source, self.sink)]
        time.sleep(0.5)  # so that the answers themselves are not measured
        before = self._read()
        time.sleep(for_s)
        after = self._read()
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
            **(_paced(status, self.status()) if has_control else {}),
        }

    def _read(self) -> Reading:
        return self.meter.read({name: (host, process.pid) for name, (host, process) in self.processes.items()})

    def react(self, rate: float, quiet_s: float) -> dict[str, Any]:
        """Change the link, and note when price, plan and publishers follow."""
        if rate < self.link.rate_bytes_per_second:
            time.sleep(max(0.0, self.rose_s + _CALM_S - time.monotonic()))
        self.source.ask(watch=True)
        time.sleep(2.0)  # so that it is matched and has received the price
        before = self.link.rate_bytes_per_second
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
        self.rose_s = time.monotonic() if rate > before else self.rose_s
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
        "gate_s": min(lower) - at_s if lower else None,  # the key of results/overhead.json, from before the price
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
        "ticks_per_second": ticks / waited_s,
    }


def _await(condition: Callable[[], bool], complaint: str) -> None:
    if not becomes_true(condition, _START_S, poll_s=0.5):
        raise OverheadError(f"{complaint} after {_START_S:.0f} s")
