"""A bad hour of a robot, in minutes: what arpd loses, how soon it is back, and what grows.

Usage: .venv/bin/python scripts/bench/reliability.py [--minutes M | --quick] [--json FILE]
       .venv/bin/python scripts/bench/reliability.py --report

Needs root, as the simulated link does.

The demo robot with arpd run, relay and peer, every process the real one, on a link that changes all the time. Processes
are killed and started again as systemd would (1 s after a kill, at once after a clean stop), the configuration is
reloaded, the link fails and its interface goes away. Beside it a running application publishes numbered samples with
AdaptivePublishers, and another process the same without arpd, to one reader: what only the first loses, arpd has lost.
Whatever kills processes happens in the first 60 per cent, so that the rest tells what grows.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import random
import re
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

if TYPE_CHECKING:
    from collections.abc import Callable

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import yaml
from pyroute2 import IPRoute

from arpd.cli.progress import progress
from scripts.bench.child import Child, ChildError
from scripts.bench.record import RESULTS, conditions, keep, target
from scripts.bench.reliability_course import CALM_S, HOUR_MINUTES, Event, schedule
from scripts.bench.reliability_nodes import DEPTH as APP_DEPTH
from scripts.bench.reliability_nodes import KINDS, RATE_HZ, TOPICS, topic_name
from scripts.bench.reliability_report import markdown
from scripts.bench.soak import footprint
from scripts.netns.namespaces import inside
from scripts.netns.simlink import SimLink
from scripts.robot.manner import WITH_ARPD
from scripts.robot.run import CONFIG, DemoError, Side, robot
from scripts.robot.sensors import BASE_DRIVER, SENSORS

_FAST, _SLOW = 20e6 / 8, 2e6 / 8
_AFTER_KILL_S = 1.0  # RestartSec= of the units
_POLL_S, _FOOTPRINT_S = 0.2, 2.0
_CALM_RESTARTS, _SETTLED_S = 5, 15.0
_PUBLISHERS = len(SENSORS) + 1 + TOPICS  # the relay's, the planner's and the application's
SOURCES = ("planner", *(topic.strip("/").replace("/", "_") for topic in SENSORS), BASE_DRIVER)
_LOUD = re.compile(r"^(WARNING|ERROR|CRITICAL) (.*)", re.MULTILINE)


@dataclass(slots=True)
class Recovery:
    """A process that was started again, and when arpd was whole again."""

    kind: str
    at_s: float
    started_s: float
    since: dict[str, int]
    answered_s: float | None = None
    planned_s: float | None = None
    whole_s: float | None = None


@dataclass(slots=True)
class Watch:
    """What anybody can see of arpd while it all happens."""

    side: Side
    pending: list[Recovery] = field(default_factory=list)
    recoveries: list[Recovery] = field(default_factory=list)
    status: dict[str, Any] | None = None
    lives: list[dict[str, Any]] = field(default_factory=list)  # totals of each life of arpd run, the last seen of it
    swaps: Counter[str] = field(default_factory=Counter)
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
        """Believe nothing more of the arpd run that is about to end."""
        with self.lock:
            self.status = None

    def is_answering(self) -> bool:
        """Whether the arpd run there is now has answered, and is ready."""
        with self.lock:
            return self.status is not None and bool(self.status["ready"])

    def expect(self, kind: str, at_s: float, since: dict[str, int]) -> None:
        """Wait for the plan to be confirmed again, from now on."""
        with self.lock:
            recovery = Recovery(kind=kind, at_s=at_s, started_s=time.monotonic(), since=since)
            self.pending.append(recovery)
            self.recoveries.append(recovery)


def is_whole(status: dict[str, Any], recovery: Recovery) -> bool:
    """Whether a plan covers all publishers there are, and all have confirmed it; or a new peer reports."""
    if recovery.kind == "kill peer":
        return status["link"]["kind"] == "peer" and any(peer["report_age_seconds"] < 0.5 for peer in status["peers"])
    plan = status["plan"]
    if recovery.kind == "kill relay" and any(
        published(status).get(topic, 0) >= count for topic, count in recovery.since.items()
    ):
        return False  # announced by the one that was killed
    return bool(status["ready"]) and plan["publishers"] >= _PUBLISHERS and plan["confirmed"] == plan["publishers"]


def published(status: dict[str, Any] | None) -> dict[str, int]:
    """Return what each relayed topic's publisher has published so far."""
    rows = status["topics"] if status else []
    return {row["topic"]: row["published"] for row in rows if row["topic"].startswith("/link/")}


class Robot:
    """The robot, its link, and what is done to them."""

    def __init__(self, side: Side, rng: random.Random) -> None:
        self._side = side
        self._rng = rng
        self._watch = Watch(side)
        self._undo: list[tuple[float, Callable[[], None]]] = []  # what a failure's end or systemd does, and when
        self._reloads = 0
        self.done: Counter[str] = Counter()
        self.footprints: dict[str, list[dict[str, Any]]] = {"run": [], "relay": [], "peer": []}
        self.started_s = time.monotonic()

    @property
    def watch(self) -> Watch:
        return self._watch

    def configure(self) -> None:
        """Write a configuration that differs from the last, and have it reloaded; one in six is refused."""
        self._reloads += 1
        if self._reloads % 6:
            self._write_good()
        else:
            self._side.config.write_text("link: {hedroom: 0.85}\n", encoding="utf-8")
        self._side.signal(signal.SIGHUP, "run")

    def _write_good(self) -> None:
        """Write a configuration that is taken; a refused one keeps a restarted process down, as it should (78)."""
        document = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
        app = {"weight": 10, "min_rate_hz": 1.2 * RATE_HZ, "max_rate_hz": 2 * RATE_HZ, "latency_budget": "none"}
        app |= {"min_depth": APP_DEPTH, "max_depth": APP_DEPTH}
        document["topics"] += [{"name": topic_name("adaptive", k), **app} for k in range(TOPICS)]
        document["defaults"] = {"weight": 1 + self._reloads % 3}
        self._side.config.write_text(yaml.safe_dump(document), encoding="utf-8")

    def play(self, events: list[Event], duration_s: float) -> None:
        """Let everything happen, each at its time."""
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
        """Kill arpd run again and again while nothing else changes, so that its plan stays what it was."""
        self._side.link.set_rate(_FAST)
        time.sleep(_SETTLED_S)
        for _ in range(times):
            self._happen(Event(at_s=0.0, kind="kill run"), -_AFTER_KILL_S)
            time.sleep(_AFTER_KILL_S)
            (_, start), *_ = self._undo
            self._undo.clear()
            start()
            self._watch.recoveries[-1].kind = "calm kill"
            time.sleep(_SETTLED_S)

    def _happen(self, event: Event, now_s: float) -> None:
        link = self._side.link
        match event.kind:
            case "rate":
                link.set_rate(math.exp(self._rng.uniform(math.log(_SLOW), math.log(_FAST))))
            case "reload":
                if self._watch.is_answering():  # systemd reloads a unit only once it has said that it is ready
                    self.configure()
                else:
                    self._later(now_s + 1.0, lambda: self._happen(event, now_s + 1.0))
            case "outage":
                link.set_loss(1.0)
                self._later(now_s + event.lasts_s, lambda: link.set_loss(0.0))
            case "interface":
                inside(link.robot.namespace, partial(_set_interface, link, is_up=False))
                self._later(
                    now_s + event.lasts_s,
                    lambda: inside(link.robot.namespace, partial(_set_interface, link, is_up=True)),
                )
            case "restart run":
                self._watch.forget()
                self._side.stop("run")
                self._watch.forget()
                self._start(event.kind, "run", {})
            case _:
                name = event.kind.removeprefix("kill ")
                since = published(self._watch.status)
                if name == "run":
                    self._watch.forget()
                self._side.signal(signal.SIGKILL, name)
                self._side.processes[name].wait()
                self._later(now_s + _AFTER_KILL_S, lambda: self._start(event.kind, name, since))

    def _later(self, at_s: float, what: Callable[[], None]) -> None:
        self._undo.append((at_s, what))

    def _start(self, kind: str, name: str, since: dict[str, int]) -> None:
        side = self._side
        if name == "run":
            self._write_good()
            side.start_daemon()
        elif name == "relay":
            self._write_good()
            side.start("relay", "robot", "arpd.cli", "relay", "--config", str(side.config))
        else:
            side.start("peer", "ceddp", "arpd.cli", "peer", "--interface", side.link.ceddp.interface, "--name", "ceddp")
        self._watch.expect(kind, time.monotonic() - self.started_s, since)

    def _note_footprints(self, now_s: float) -> None:
        for name, notes in self.footprints.items():
            process = self._side.processes[name]
            if process.poll() is None:
                with contextlib.suppress(OSError, KeyError, ValueError):  # it may end just now
                    notes.append({"at_s": now_s, "pid": process.pid, **footprint(process.pid)})


def _set_interface(link: SimLink, *, is_up: bool) -> None:
    """Take the robot's interface down, or up again with the neighbour and the route that went with it."""
    host = link.robot
    with IPRoute() as route:
        index = route.link_lookup(ifname=host.interface)[0]
        route.link("set", index=index, state="up" if is_up else "down")
        if is_up:
            route.neigh("replace", dst=host.peer_address, lladdr=host.peer_mac, ifindex=index, state="permanent")
            route.route("replace", dst="224.0.0.0/4", oif=index, scope="link")


def run(minutes: float, workdir: Path, seed: int) -> dict[str, Any]:
    """Play it all, and return what was noted."""
    rng = random.Random(seed)
    events = schedule(minutes, rng)
    with SimLink(f"reliability-{os.getpid()}", rate_bytes_per_second=_FAST) as link:
        reader = Child(link, "ceddp", "scripts.bench.reliability_nodes", "reader")
        reader.hear()
        with robot(link, workdir, WITH_ARPD) as side:
            played = Robot(side, rng)
            talkers = {kind: _talker(link, kind) for kind in KINDS}
            for talker in talkers.values():
                talker.hear()
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
        "log": {name: _loud(workdir / f"{name}.log") for name in played.footprints},
    }


def _talker(link: SimLink, kind: str) -> Child:
    # Without arpd means without its profile, too: the middleware's own default.
    environment = {} if kind == "adaptive" else {"FASTRTPS_DEFAULT_PROFILES_FILE": ""}
    return Child(link, "robot", "scripts.bench.reliability_nodes", "talker", kind, environment=environment)


def _await_plan(watch: Watch) -> None:
    watch.expect("start", 0.0, {})
    until_s = time.monotonic() + 60.0
    while watch.pending:
        if time.monotonic() > until_s:
            raise DemoError(f"no plan is confirmed within a minute: {watch.status and watch.status['plan']}")
        time.sleep(0.1)


def _loud(path: Path) -> dict[str, int]:
    """Count the log's lines at WARNING and above, numbers taken out so that like counts as like."""
    found = _LOUD.findall(path.read_text(encoding="utf-8", errors="replace"))
    return dict(Counter(f"{level} {re.sub(r'[0-9][0-9.]*', 'N', text)[:160]}" for level, text in found).most_common(20))


def security_scores() -> dict[str, str]:
    """Return what systemd-analyze says of each unit, empty where it is not there."""
    scores: dict[str, str] = {}
    units = Path(__file__).resolve().parents[2] / "systemd"
    for unit in sorted(units.glob("*.service")):
        try:
            said = subprocess.run(
                ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)],
                capture_output=True,
                text=True,
                check=False,
            ).stdout
        except FileNotFoundError:
            return {}
        if match := re.search(r"exposure level for \S+: ([0-9.]+)", said):
            scores[unit.name] = match[1]
    return scores


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=HOUR_MINUTES, metavar="M", help="default %(default)g")
    parser.add_argument("--quick", action="store_true", help="about a minute and a half")
    parser.add_argument("--seed", type=int, default=1, help="another order of events")
    parser.add_argument("--json", type=Path, metavar="FILE", help="default results/reliability.json")
    parser.add_argument("--fuzz", type=Path, default=RESULTS / "fuzz.json", metavar="FILE", help="what fuzz.py found")
    parser.add_argument("--report", action="store_true", help="play nothing: print the table of what was noted last")
    options = parser.parse_args()
    if options.report:
        document = json.loads((options.json or RESULTS / "reliability.json").read_text(encoding="utf-8"))
    else:
        document = {"conditions": conditions()}
        with tempfile.TemporaryDirectory(prefix="arpd-reliability-") as workdir:
            try:
                document |= run(1.5 if options.quick else options.minutes, Path(workdir), options.seed)
            except (ChildError, DemoError) as error:
                sys.exit(f"reliability: {error}")
        document["security"] = security_scores()
        keep(document, target(options.json, "reliability.json", is_partial=options.quick))
    fuzz = json.loads(options.fuzz.read_text(encoding="utf-8")) if options.fuzz.exists() else None
    print(markdown(document, fuzz))


if __name__ == "__main__":
    main()
