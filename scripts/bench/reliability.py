"""Play a bad hour of a robot in minutes: what arpd loses, how soon it recovers, and what grows.

Usage: .venv/bin/python scripts/bench/reliability.py [--minutes M | --quick] [--json FILE]
       .venv/bin/python scripts/bench/reliability.py --report

Needs root, as the simulated link does.

The demo robot with the real processes of arpd run, relay and peer, on a link that changes all the time. Processes are
killed and started again as systemd does it (1 s after a kill, at once after a clean stop), the configuration is
reloaded, the link fails, and its interface goes away. An application publishes numbered samples with
AdaptivePublishers, and another process the same without arpd, to one reader: a loss of the first alone is arpd's.
All kills happen in the first 60 per cent, so that the rest shows what grows.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import yaml
from pyroute2 import IPRoute

from arpd.cli.progress import progress
from scripts.bench.child import Child, ChildError, footprint
from scripts.bench.node import becomes_true
from scripts.bench.record import REPO, RESULTS, conditions, keep, options_of, read
from scripts.bench.reliability_course import CALM_S, HOUR_MINUTES, Event, schedule
from scripts.bench.reliability_figures import report
from scripts.bench.reliability_nodes import DEPTH as APP_DEPTH
from scripts.bench.reliability_nodes import KINDS, RATE_HZ, TOPICS, topic_name
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_ARPD
from scripts.robot.run import CONFIG, SOURCES, DemoError, Side, robot
from scripts.robot.sensors import SENSORS

if TYPE_CHECKING:
    from collections.abc import Callable

_FAST, _SLOW = 20e6 / 8, 2e6 / 8
_AFTER_KILL_S = 1.0  # RestartSec= of the units
_POLL_S, _FOOTPRINT_S = 0.2, 2.0
_CALM_RESTARTS, _SETTLED_S = 5, 15.0
_PUBLISHERS = len(SENSORS) + 1 + TOPICS  # the relay's, the planner's and the application's
_LOUD = re.compile(r"^(WARNING|ERROR|CRITICAL) (.*)", re.MULTILINE)


@dataclass(slots=True)
class Recovery:
    """A process that was started again, and the times until arpd answered, planned and was whole (s)."""

    kind: str
    at_s: float
    started_s: float
    since: dict[str, int]
    answered_s: float | None = None
    planned_s: float | None = None
    whole_s: float | None = None


@dataclass(slots=True)
class Watch:
    """Watch arpd's status page during the run."""

    side: Side
    pending: list[Recovery] = field(default_factory=list)
    recoveries: list[Recovery] = field(default_factory=list)
    status: dict[str, Any] | None = None
    lives: list[dict[str, Any]] = field(default_factory=list)  # last totals of each life of arpd run
    lock: threading.Lock = field(default_factory=threading.Lock)
    stopping: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        while not self.stopping.wait(_POLL_S):
            status = self.side.status()
            now_s = time.monotonic()
            with self.lock:
                self.status = status
                if status is not None and "totals" in status:
                    self._note(status, now_s)

    def _note(self, status: dict[str, Any], now_s: float) -> None:
        totals = status["totals"]
        if not self.lives or totals["ticks"] < self.lives[-1]["ticks"]:
            self.lives.append(totals)
        self.lives[-1] = totals
        for recovery in list(self.pending):
            if recovery.answered_s is None:
                recovery.answered_s = now_s - recovery.started_s
            if recovery.planned_s is None and status["plan"]["publishers"] >= _PUBLISHERS:
                recovery.planned_s = now_s - recovery.started_s
            if is_whole(status, recovery):
                recovery.whole_s = now_s - recovery.started_s
                self.pending.remove(recovery)

    def forget(self) -> None:
        """Drop the status of the arpd run that is about to end."""
        with self.lock:
            self.status = None

    def is_answering(self) -> bool:
        """Return whether the current arpd run has answered and is ready."""
        with self.lock:
            return self.status is not None and bool(self.status["ready"])

    def expect(self, kind: str, at_s: float, since: dict[str, int]) -> None:
        """Note from now on when the plan is confirmed again."""
        with self.lock:
            recovery = Recovery(kind=kind, at_s=at_s, started_s=time.monotonic(), since=since)
            self.pending.append(recovery)
            self.recoveries.append(recovery)


def is_whole(status: dict[str, Any], recovery: Recovery) -> bool:
    """Return whether all publishers have confirmed a plan for all of them; for a peer, whether it reports."""
    if recovery.kind == "kill peer":
        return status["link"]["kind"] == "peer" and any(peer["report_age_seconds"] < 0.5 for peer in status["peers"])
    plan = status["plan"]
    if recovery.kind == "kill relay" and any(
        published(status).get(topic, 0) >= count for topic, count in recovery.since.items()
    ):
        return False  # announcements of the killed relay
    return bool(status["ready"]) and plan["publishers"] >= _PUBLISHERS and plan["confirmed"] == plan["publishers"]


def published(status: dict[str, Any] | None) -> dict[str, int]:
    """Return the number of samples that each relayed topic's publisher has published."""
    rows = status["topics"] if status else []
    return {row["topic"]: row["published"] for row in rows if row["topic"].startswith("/link/")}


class Robot:
    """The robot, its link, and the events that happen to them."""

    def __init__(self, side: Side, rng: random.Random) -> None:
        self._side = side
        self._rng = rng
        self.watch = Watch(side)
        self._undo: list[tuple[float, Callable[[], None]]] = []  # when a failure ends or systemd acts, and how
        self._reloads = 0
        self._loss = 0.0  # of the link outside of outages
        self.done: Counter[str] = Counter()
        self.footprints: dict[str, list[dict[str, Any]]] = {"run": [], "relay": [], "peer": []}
        self.started_s = time.monotonic()

    def configure(self) -> None:
        """Write a configuration that differs from the last, and reload; arpd must refuse one in six."""
        self._reloads += 1
        if self._reloads % 6:
            self._write_good()
        else:
            self._side.config.write_text("link: {hedroom: 0.85}\n", encoding="utf-8")
        self._side.signal(signal.SIGHUP, "run")

    def _write_good(self) -> None:
        """Write a valid configuration; with an invalid one a restarted process ends with 78, by design."""
        document = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
        app = {"weight": 10, "min_rate_hz": 1.2 * RATE_HZ, "max_rate_hz": 2 * RATE_HZ, "latency_budget": "none"}
        app |= {"min_depth": APP_DEPTH, "max_depth": APP_DEPTH}
        document["topics"] += [{"name": topic_name("adaptive", k), **app} for k in range(TOPICS)]
        document["defaults"] = {"weight": 1 + self._reloads % 3}
        self._side.config.write_text(yaml.safe_dump(document), encoding="utf-8")

    def play(self, events: list[Event], duration_s: float) -> None:
        """Play every event at its time."""
        self.started_s = time.monotonic()
        events = list(events)
        next_footprint_s = 0.0
        with progress("playing", total=duration_s) as shown:
            while (now_s := time.monotonic() - self.started_s) < duration_s:
                shown.reach(now_s)
                while events and events[0].at_s <= now_s:
                    event = events.pop(0)
                    shown.reach(now_s, event.kind)
                    self.done[event.kind] += 1
                    self._happen(event, now_s)
                for entry in [entry for entry in self._undo if entry[0] <= now_s]:
                    self._undo.remove(entry)
                    entry[1]()
                if now_s >= next_footprint_s:
                    next_footprint_s = now_s + _FOOTPRINT_S
                    self._note_footprints(now_s)
                time.sleep(0.02)
        for _, undo in self._undo:
            undo()
        self._undo.clear()

    def restart_calmly(self, times: int) -> None:
        """Kill arpd run several times while nothing else changes, so that its plan stays the same."""
        self._side.link.set_rate(_FAST)
        time.sleep(_SETTLED_S)
        for _ in range(times):
            self._happen(Event(at_s=0.0, kind="kill run"), -_AFTER_KILL_S)
            time.sleep(_AFTER_KILL_S)
            (_, start), *_ = self._undo
            self._undo.clear()
            start()
            self.watch.recoveries[-1].kind = "calm kill"
            time.sleep(_SETTLED_S)

    def _happen(self, event: Event, now_s: float) -> None:
        link = self._side.link
        match event.kind:
            case "rate":
                link.set_rate(math.exp(self._rng.uniform(math.log(_SLOW), math.log(_FAST))))
            case "reload":
                if self.watch.is_answering():  # systemd reloads a unit only after it has reported ready
                    self.configure()
                else:
                    self._later(now_s + 1.0, lambda: self._happen(event, now_s + 1.0))
            case "outage":
                link.set_loss(1.0)
                self._later(now_s + event.lasts_s, lambda: link.set_loss(self._loss))
            case "interface":
                inside(link.robot.namespace, partial(_set_interface, link, is_up=False))
                restore = partial(inside, link.robot.namespace, partial(_set_interface, link, is_up=True))
                self._later(now_s + event.lasts_s, restore)
            case "restart run":
                self.watch.forget()
                self._side.stop("run")
                self.watch.forget()
                self._start(event.kind, "run", {})
            case _:
                name = event.kind.removeprefix("kill ")
                since = published(self.watch.status)
                if name == "run":
                    self.watch.forget()
                self._side.signal(signal.SIGKILL, name)
                self._side.processes[name].wait()
                self._later(now_s + _AFTER_KILL_S, lambda: self._start(event.kind, name, since))

    def _later(self, at_s: float, what: Callable[[], None]) -> None:
        self._undo.append((at_s, what))

    def _start(self, kind: str, name: str, since: dict[str, int]) -> None:
        side = self._side
        if name != "peer":
            self._write_good()
        {"run": side.start_daemon, "relay": side.start_relay, "peer": side.start_peer}[name]()
        self.watch.expect(kind, time.monotonic() - self.started_s, since)

    def _note_footprints(self, now_s: float) -> None:
        for name, notes in self.footprints.items():
            process = self._side.processes[name]
            if process.poll() is None:
                with contextlib.suppress(OSError, KeyError, ValueError):  # it may end at this moment
                    notes.append({"at_s": now_s, "pid": process.pid, **footprint(process.pid)})


def _set_interface(link: SimLink, *, is_up: bool) -> None:
    """Take the robot's interface down, or up again with the neighbour and the route that were lost with it."""
    host = link.robot
    with IPRoute() as route:
        index = route.link_lookup(ifname=host.interface)[0]
        route.link("set", index=index, state="up" if is_up else "down")
        if is_up:
            route.neigh("replace", dst=host.peer_address, lladdr=host.peer_mac, ifindex=index, state="permanent")
            route.route("replace", dst="224.0.0.0/4", oif=index, scope="link")


def run(minutes: float, workdir: Path, seed: int) -> dict[str, Any]:
    """Play the whole run, and return its notes."""
    rng = random.Random(seed)
    events = schedule(minutes, rng)
    with SimLink(f"reliability-{os.getpid()}", rate_bytes_per_second=_FAST) as link:
        reader = Child(link, "ceddp", "scripts.bench.reliability_nodes", "reader")
        reader.receive()
        with robot(link, workdir, WITH_ARPD) as side:
            played = Robot(side, rng)
            talkers = {kind: _talker(link, kind) for kind in KINDS}
            for talker in talkers.values():
                talker.receive()
            side.signal(signal.SIGUSR1, *SOURCES)
            played.configure()
            watching = threading.Thread(target=played.watch.run, daemon=True)
            watching.start()
            _await_plan(played.watch)
            played.play(events, minutes * 60.0)
            played.restart_calmly(_CALM_RESTARTS)
            sent = {kind: talker.ask(stop=True)["sent"] for kind, talker in talkers.items()}
            time.sleep(CALM_S)
            arrived = reader.ask(sent=sent)["topics"]
            played.watch.stopping.set()
            watching.join()
            for child in (*talkers.values(), reader):
                child.end()
    return {
        "minutes": minutes,
        "seed": seed,
        "load_average": os.getloadavg(),
        "events": dict(played.done),
        "topics": arrived,
        "recoveries": [
            {key: getattr(one, key) for key in ("kind", "at_s", "answered_s", "planned_s", "whole_s")}
            for one in played.watch.recoveries
        ],
        "lives": played.watch.lives,
        "footprints": played.footprints,
        "log": {name: loud(workdir / f"{name}.log") for name in played.footprints},
    }


def _talker(link: SimLink, kind: str) -> Child:
    # Without arpd also means without its profile: the middleware's default.
    environment = {} if kind == "adaptive" else {"FASTRTPS_DEFAULT_PROFILES_FILE": ""}
    return Child(link, "robot", "scripts.bench.reliability_nodes", "talker", kind, environment=environment)


def _await_plan(watch: Watch) -> None:
    watch.expect("start", 0.0, {})
    if not becomes_true(lambda: not watch.pending, 60.0, poll_s=0.1):
        raise DemoError(f"no plan is confirmed within a minute: {watch.status and watch.status['plan']}")


def loud(path: Path) -> dict[str, int]:
    """Count the log's lines at WARNING and above, without their numbers, so that similar lines count together."""
    found = _LOUD.findall(path.read_text(encoding="utf-8", errors="replace"))
    return dict(Counter(f"{level} {re.sub(r'[0-9][0-9.]*', 'N', text)[:160]}" for level, text in found).most_common(20))


def security_scores() -> dict[str, str]:
    """Return the score of each unit by systemd-analyze; empty without it."""
    if (analyze := shutil.which("systemd-analyze")) is None:
        return {}
    scores: dict[str, str] = {}
    for unit in sorted((REPO / "systemd").glob("*.service")):
        command = [analyze, "security", "--offline=true", "--no-pager", str(unit)]
        printed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        if match := re.search(r"exposure level for \S+: ([0-9.]+)", printed):
            scores[unit.name] = match[1]
    return scores


def main() -> None:
    parser = options_of(__doc__, "reliability", quick="about a minute and a half")
    parser.add_argument("--minutes", type=float, default=HOUR_MINUTES, metavar="M", help="default %(default)g")
    parser.add_argument("--seed", type=int, default=1, help="another order of events")
    parser.add_argument("--fuzz", type=Path, default=RESULTS / "fuzz.json", metavar="FILE", help="results of fuzz.py")
    parser.add_argument("--report", action="store_true", help="play nothing; print the table of the last run")
    options = parser.parse_args()
    if options.report:
        document = read(options.json or RESULTS / "reliability.json")
    else:
        document = {"conditions": conditions()}
        with tempfile.TemporaryDirectory(prefix="arpd-reliability-") as workdir:
            try:
                document |= run(1.5 if options.quick else options.minutes, Path(workdir), options.seed)
            except (ChildError, DemoError) as error:
                sys.exit(f"reliability: {error}")
        document["security"] = security_scores()
        keep(document, options, "reliability", is_partial=options.quick)
    print(report(document, read(options.fuzz) if options.fuzz.exists() else None))


if __name__ == "__main__":
    main()
