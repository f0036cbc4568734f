"""Play ten bad minutes of a relay with two ends: what is lost, doubled or out of order, and how soon it flows again.

Usage: .venv/bin/python scripts/bench/two_ends.py [--minutes M | --quick] [--calls] [--ip-change] [--json FILE]
       .venv/bin/python scripts/bench/two_ends.py --report

Needs root, as the simulated link does.

Plain rclpy nodes on both hosts see only their own host. `arpd run`, `arpd relay` and `arpd peer` on the robot and
`arpd relay --far` on the CEDDP join them over a link of 2 to 20 Mbit/s that changes all the time, fails for seconds,
and loses one packet in a hundred after the first 40 per cent of the run. All kills happen in the first 60 per cent, in
several states of the ends; a killed process starts again after 1 s, as systemd does it.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import yaml

from scripts.bench.child import Child, ChildError
from scripts.bench.node import becomes_true
from scripts.bench.record import RESULTS, conditions, keep, options_of, read
from scripts.bench.reliability import Robot, loud
from scripts.bench.reliability_course import CALM_S, Event, schedule
from scripts.bench.two_ends_account import Death, Reading
from scripts.bench.two_ends_address import Addresses, SharingHosts, widen
from scripts.bench.two_ends_calls import ACTION, GOAL_FAILED_S, SERVICE
from scripts.bench.two_ends_findings import Course, calls_of, demand_of, latched_of, report, sets_of_three, topics_of
from scripts.bench.two_ends_nodes import SET_TOPICS, STREAMS
from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_TWO_ENDS
from scripts.robot.proxy import window
from scripts.robot.run import HTTP_PORT, DemoError, Side

#: Events of ten minutes; a shorter run has its share of each kind, and at least one.
TEN_MINUTES = {
    "rate": 60,
    "outage": 6,
    "kill run": 4,
    "kill relay": 4,
    "kill relay_far": 4,
    "kill relay again": 2,  # while it starts
    "kill relay_far again": 2,
    "kill relay in an outage": 2,
    "kill relay_far in an outage": 2,
    "kill both": 2,
}
MINUTES, QUICK_MINUTES = 10.0, 2.0
LOSS, LOSSY_FROM = 0.01, 0.4  # of the packets, and of the run
PROCESSES = ("run", "relay", "relay_far", "peer")
_FAST = 20e6 / 8
_AFTER_KILL_S = 1.0  # RestartSec= of the units
_POLL_S = 0.2
_START_S, _DRAIN_S = 60.0, 8.0
_AGAIN_S = 1.5  # from a start to the next kill
_OUTAGE_S, _INTO_OUTAGE_S = 4.0, 1.0
_DEEP = 1000  # longer than any outage here


def configuration(link: SimLink, *, has_calls: bool) -> str:
    """Return arpd's configuration: the topics that nobody may thin have rates above their own, and deep histories."""
    kept = {stream.topic: stream for stream in STREAMS if not stream.is_paced}
    total_hz = {topic: sum(each.rate_hz for each in STREAMS if each.topic == topic) for topic in kept}
    own = {"weight": 10, "latency_budget": "none", "min_depth": _DEEP, "max_depth": _DEEP}
    relay: dict[str, Any] = {
        "link_domain": 102,  # SimLink takes lower ones
        "robot": link.robot.address,
        "ceddp": link.ceddp.address,
        "topics": [{"name": topic, "overflow": "queue", "depth": _DEEP} for topic in kept],
        "groups": [{"topics": list(SET_TOPICS), "by": "stamp"}],
    }
    if has_calls:
        relay |= {"services": [SERVICE], "actions": [ACTION]}
    topics = [
        {"name": topic, "min_rate_hz": 1.2 * rate_hz, "max_rate_hz": 2 * rate_hz, **own}
        for topic, rate_hz in total_hz.items()
    ]
    return str(yaml.safe_dump({"relay": relay, "topics": topics}))


@dataclass(slots=True)
class Watch:
    """Reads the counters of all publishers on the link from arpd's status."""

    side: Side
    readings: dict[tuple[str, str], list[Reading]] = field(default_factory=lambda: defaultdict(list))
    stopping: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        while not self.stopping.wait(_POLL_S):
            if (status := self.side.status()) is not None and "topics" in status:
                self.note(status, time.monotonic())

    def note(self, status: dict[str, Any], now_s: float) -> None:
        """Keep the counters of each topic and host that have changed."""
        for topic in status["topics"]:
            known = self.readings[topic["topic"], "ceddp" if "_far_" in topic["node"] else "robot"]
            age_s = (status["age_seconds"] or 0.0) + (topic["age_seconds"] or 0.0)
            counters = {name: topic[name] for name in ("offered", "published", "withheld")}
            reading = Reading(at_s=now_s - age_s, **counters)
            if not known or known[-1].offered != reading.offered:
                known.append(reading)


class TwoEndedRobot(Robot):
    """The robot, both ends of its relay, and the events that happen to them."""

    def __init__(self, side: Side, rng: random.Random) -> None:
        super().__init__(side, rng)
        self.footprints = {name: [] for name in PROCESSES}
        self.killed_s: dict[str, float] = {}
        self.course = Course()

    def _happen(self, event: Event, now_s: float) -> None:
        match event.kind.split(maxsplit=2):
            case ["lossy"]:
                self._loss = LOSS
                self._side.link.set_loss(LOSS)
                self.course.lossy_from_s = time.monotonic()
            case ["outage"]:
                self._note("outage", event.lasts_s)
                super()._happen(event, now_s)
            case ["kill", "both"]:
                self._kill("relay", now_s)
                self._kill("relay_far", now_s)
            case ["kill", name, "again"]:
                self._kill(name, now_s)
                again_s = now_s + _AFTER_KILL_S + _AGAIN_S
                self._later(again_s, lambda: self._kill(name, again_s))
            case ["kill", name, "in an outage"]:
                outage = Event(at_s=now_s, kind="outage", lasts_s=_OUTAGE_S)
                self._happen(outage, now_s)
                kill_s = now_s + _INTO_OUTAGE_S
                self._later(kill_s, lambda: self._kill(name, kill_s))
            case ["kill", name]:
                self._kill(name, now_s)
            case _:
                super()._happen(event, now_s)

    def _kill(self, name: str, now_s: float) -> None:
        process = self._side.processes[name]
        self.killed_s[name] = time.monotonic()
        self._note(name, _AFTER_KILL_S)
        process.send_signal(signal.SIGKILL)
        process.wait()
        self._later(now_s + _AFTER_KILL_S, lambda: self._begin(name))

    def _begin(self, name: str) -> None:
        start(self._side, name)
        host = {"relay": "robot", "relay_far": "ceddp"}.get(name)
        if host is not None:
            self.course.deaths.append(Death(host=host, killed_s=self.killed_s[name], started_s=time.monotonic()))

    def _note(self, what: str, lasts_s: float) -> None:
        now_s = time.monotonic()
        self.course.disturbed.append((what, now_s, now_s + lasts_s))

    def _note_footprints(self, now_s: float) -> None:
        """Note them, and start again what ended itself."""
        super()._note_footprints(now_s)
        for name in PROCESSES:
            process = self._side.processes[name]
            if (code := process.poll()) is not None and code != -signal.SIGKILL:
                self.course.ended.append(f"{name} with {code} at {now_s:.0f} s")
                self.killed_s[name] = time.monotonic()
                self._begin(name)


def start(side: Side, name: str) -> None:
    """Start one of arpd's processes."""
    starts = (side.start_daemon, side.start_relay, side.start_far_relay, side.start_peer)
    dict(zip(PROCESSES, starts, strict=True))[name]()


class World:
    """Both hosts with all their processes.

    Parameters
    ----------
    link : joins them
    workdir : folder for arpd's logs
    demand_every_s, latched_every_s : time between two readers on demand, and between two late readers
    calls_over_s : time over which a caller spreads its calls, 0 = there is no caller
    """

    def __init__(
        self, link: SimLink, workdir: Path, *, demand_every_s: float, latched_every_s: float, calls_over_s: float = 0.0
    ) -> None:
        self._calls_over_s = calls_over_s
        self._every = (repr(demand_every_s), repr(latched_every_s))
        self.link = link
        self.side = Side(self.link, workdir, WITH_TWO_ENDS)
        self.nodes: dict[str, Child] = {}
        self.calls: dict[str, Child] = {}

    def nodes_on(self, host: Any, *argv: str) -> Child:
        """Start a process of plain nodes that stay on their host."""
        environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": "", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        return Child(self.link, host, *argv, environment=environment)

    def begin(self) -> None:
        """Start everything, and let the nodes publish once every writer has its reader on the other host."""
        self.side.config.write_text(configuration(self.link, has_calls=self._calls_over_s > 0), encoding="utf-8")
        for host in ("robot", "ceddp"):
            self.nodes[host] = self.nodes_on(host, "scripts.bench.two_ends_nodes", host, *self._every)
        for name in PROCESSES:
            start(self.side, name)
        for child in self.nodes.values():
            child.receive()
        for host, child in self.nodes.items():
            if not becomes_true(partial(_says, child, "matched"), _START_S, poll_s=0.3):
                raise DemoError(f"the writers and readers of the {host} found no partners on the other side")
        if self._calls_over_s:
            self._begin_calls()
        time.sleep(2.0)
        for child in self.nodes.values():
            child.ask(do="begin")
        if self.calls:
            self.calls["caller"].ask(do="begin")

    def restart_nodes(self, host: str) -> None:
        """Start the plain nodes of a host again, and let them publish."""
        self.nodes[host].end()
        child = self.nodes[host] = self.nodes_on(host, "scripts.bench.two_ends_nodes", host, *self._every)
        child.receive()
        child.ask(do="begin")

    def _begin_calls(self) -> None:
        module = "scripts.bench.two_ends_calls"
        self.calls["server"] = self.nodes_on("robot", module, "serve")
        caller = self.calls["caller"] = self.nodes_on("ceddp", module, "call", repr(self._calls_over_s))
        for child in self.calls.values():
            child.receive()
        if not becomes_true(partial(_says, caller, "ready"), _START_S, poll_s=0.3):
            raise DemoError("the caller on the CEDDP found no server")

    def end(self) -> dict[str, dict[str, Any]]:
        """Stop publishing; return what each host sent and received."""
        found = {host: child.ask(do="end") for host, child in self.nodes.items()}
        time.sleep(GOAL_FAILED_S if self.calls else _DRAIN_S)
        for name, child in (*self.nodes.items(), *self.calls.items()):
            found.setdefault(name, {}).update(child.ask(do="report"))
            child.end()
        return found


def _says(child: Child, question: str) -> bool:
    return bool(child.ask(do=question)[question])


def run(minutes: float, workdir: Path, seed: int, *, has_calls: bool = False) -> dict[str, Any]:
    """Play the whole run, and return its notes."""
    rng = random.Random(seed)
    events = schedule(minutes, rng, TEN_MINUTES, of_minutes=MINUTES)
    lossy = Event(at_s=LOSSY_FROM * minutes * 60.0, kind="lossy")
    events = sorted([*events, lossy], key=lambda event: event.at_s)
    is_short = minutes < MINUTES / 2
    world = World(
        SimLink(f"two-ends-{os.getpid()}", rate_bytes_per_second=_FAST),
        workdir,
        demand_every_s=12.0 if is_short else 20.0,
        latched_every_s=20.0 if is_short else 60.0,
        calls_over_s=minutes * 60.0 - CALM_S if has_calls else 0.0,
    )
    with world.link, window(world.link.robot, HTTP_PORT) as url:
        world.side.url = url
        watch = Watch(world.side)
        world.begin()
        watching = threading.Thread(target=watch.run, daemon=True)
        watching.start()
        played = TwoEndedRobot(world.side, rng)
        played.play(events, minutes * 60.0)
        found = world.end()
        watch.stopping.set()
        watching.join()
    course = played.course
    deaths = course.lasting_deaths()
    return {
        "minutes": minutes,
        "seed": seed,
        "load_average": os.getloadavg(),
        "events": dict(played.done),
        "ended_themselves": course.ended,
        "started_s": played.started_s,
        "disturbed": course.disturbed,
        "topics": topics_of(found, watch.readings, deaths),
        "sets": sets_of_three(found, watch.readings, deaths),
        "demand": demand_of(found, course),
        "latched": latched_of(found, course),
        "calls": calls_of(found, course) if has_calls else {},
        "footprints": played.footprints,
        "log": {name: loud(workdir / f"{name}.log") for name in PROCESSES},
    }


def run_addresses(workdir: Path) -> dict[str, Any]:
    """Change the address of each end on a steady link, and return when every topic flowed again."""
    return {"addresses": [_changed_address(workdir, place) for place in range(2)]}


def _changed_address(workdir: Path, place: int) -> dict[str, Any]:
    """Change the address of one end, by its place in `SimLink.hosts`, in a world of its own."""
    with tempfile.TemporaryDirectory(prefix="arpd-two-ends-", dir="/dev/shm") as memory:
        link = SharingHosts(f"two-ends-{os.getpid()}", Path(memory), rate_bytes_per_second=_FAST)
        world = World(link, workdir, demand_every_s=1e6, latched_every_s=1e6)
        with link, window(link.robot, HTTP_PORT) as url:
            widen(link.hosts)
            world.side.url = url
            world.begin()
            addresses = Addresses(
                world.side,
                world.nodes,
                start=partial(start, world.side),
                start_nodes=world.restart_nodes,
                processes=PROCESSES,
            )
            return addresses.change(link.hosts[place])


def main() -> None:
    parser = options_of(__doc__, "two_ends", quick="two minutes")
    parser.add_argument("--minutes", type=float, default=MINUTES, metavar="M", help="default %(default)g")
    parser.add_argument("--seed", type=int, default=1, help="another order of events")
    parser.add_argument("--calls", action="store_true", help="with service calls and actions")
    parser.add_argument("--ip-change", action="store_true", help="only change the addresses of both ends")
    parser.add_argument("--report", action="store_true", help="play nothing; print the table of the last run")
    parser.add_argument("--keep-logs", type=Path, metavar="FOLDER", help="put arpd's logs there")
    options = parser.parse_args()
    if options.report:
        document = read(options.json or RESULTS / "two_ends.json")
    else:
        document = {"conditions": conditions()}
        with tempfile.TemporaryDirectory(prefix="arpd-two-ends-") as temporary:
            workdir = options.keep_logs or Path(temporary)
            workdir.mkdir(parents=True, exist_ok=True)
            try:
                if options.ip_change:
                    document |= run_addresses(workdir)
                else:
                    minutes = QUICK_MINUTES if options.quick else options.minutes
                    document |= run(minutes, workdir, options.seed, has_calls=options.calls)
            except (ChildError, DemoError) as error:
                sys.exit(f"two_ends: {error}")
        keep(document, options, "two_ends", is_partial=options.quick or options.ip_change)
    print(report(document))


if __name__ == "__main__":
    main()
