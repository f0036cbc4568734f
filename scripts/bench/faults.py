"""Play bad minutes: what is lost when processes and links fail, and how soon everything flows again.

The link has 2 to 20 Mbit/s, another rate every ten seconds, fails for seconds, and loses one packet in a hundred in the
last 40 per cent of the run. Processes are killed in the first 60 per cent and start again after 1 s, as by systemd;
the configuration is reloaded. What does not arrive while an end is dead, or the link out, is beside a break; a break
lasts from the last sample before it to the first after it.
"""

from __future__ import annotations

import math
import random
import signal
import threading
import time
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.child import becomes_true
from scripts.bench.links import MBIT, Course
from scripts.bench.report import Summary, figure, table
from scripts.bench.samples import BASE, Topic
from scripts.bench.sides import SIDES, Robot, Service
from scripts.bench.world import World, world_of

if TYPE_CHECKING:
    from collections.abc import Callable

MINUTES, QUICK_MINUTES = 2.5, 0.75
_AFTER_KILL_S = 1.0  # RestartSec= of the units
_FAST, _SLOW, _OUT_S, _LOSS = 20 * MBIT, 2 * MBIT, 4.0, 0.01
_PLANNED_S = 30.0
SETS = ("/left/image", "/left/camera_info", "/right/image")
#: Kills in ten minutes, by what is killed; a shorter run has its share of each, and at least one.
KILLS: dict[str, dict[tuple[str, ...], int]] = {
    "two_ends": {("run",): 4, ("relay",): 6, ("relay_far",): 6, ("relay", "relay_far"): 2, ("peer",): 2},
    "adaptive": {("run",): 8, ("peer",): 4},
}


def _kept(name: str, rate_hz: float, size: int, node: str, **more: Any) -> Topic:
    return Topic(name=name, type_name="std_msgs/String", rate_hz=rate_hz, size=size, node=node, is_kept=True, **more)


def _thinned(name: str, rate_hz: float, size: int, kind: str = "std_msgs/String") -> Topic:
    return Topic(name=name, type_name=kind, rate_hz=rate_hz, size=size, node="sensors", depth=100)


ROBOT = Robot(
    topics=(
        _kept("/imu", 50.0, 200, "chassis"),
        _kept("/tf", 20.0, 100, "chassis", publishers=2),
        _kept("/cmd_vel", 20.0, 76, BASE),
        _thinned("/scan", 10.0, 2_000),
        _thinned("/points", 10.0, 30_000),
        *(
            _thinned(
                name,
                10.0,
                380 if "info" in name else 10_000,
                f"sensor_msgs/{'CameraInfo' if 'info' in name else 'Image'}",
            )
            for name in SETS
        ),
    ),
    service=Service(name="/plan_path", node="planner", answer_bytes=1_000, every_s=0.5, fails_s=8.0),
)

_KEPT = {topic.name for topic in ROBOT.topics if topic.is_kept}


@dataclass(slots=True)
class Story:
    """What happens to a world, planned before it begins, in seconds from the time that counts.

    Attributes
    ----------
    breaks : when an end died or the link went out, and when samples could cross again (s, s)
    planned_s : time from each new start of `arpd run` until it has planned for all again (s); None = not in time
    """

    world: World
    events: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    breaks: list[tuple[float, float]] = field(default_factory=list)
    planned_s: list[float | None] = field(default_factory=list)
    done: Counter[str] = field(default_factory=Counter)
    watching: list[threading.Thread] = field(default_factory=list)
    topics: int = 0

    def kill(self, at_s: float, names: tuple[str, ...]) -> None:
        """Kill processes, and start them again as systemd does."""
        self.done[f"kill {' and '.join(names)}"] += 1
        for name in names:
            self.events.append((at_s, partial(self._kill, name)))
            self.events.append((at_s + _AFTER_KILL_S, partial(self._start, name)))
        if {"relay", "relay_far"} & {*names}:
            self.breaks.append((at_s, at_s + _AFTER_KILL_S))

    def _kill(self, name: str) -> None:
        if name == "run":
            self.topics = self._planned()
        process = self.world.daemons[name]
        if process.poll() is not None:
            self.world.ended.append(name)
        process.send_signal(signal.SIGKILL)
        process.wait()

    def _start(self, name: str) -> None:
        self.world.start_daemon(name)
        if name == "run":
            self.watching.append(threading.Thread(target=self._watch, args=(self.topics,), daemon=True))
            self.watching[-1].start()

    def _watch(self, topics: int) -> None:
        began_s = time.monotonic()
        is_back = becomes_true(lambda: self._planned() >= topics, _PLANNED_S, poll_s=0.2)
        self.planned_s.append(time.monotonic() - began_s if is_back else None)

    def _planned(self) -> int:
        """Return for how many topics arpd has a plan."""
        return sum(topic["planned"] is not None for topic in (self.world.status() or {"topics": []})["topics"])

    def reload(self, at_s: float) -> None:
        """Reload the configuration."""
        self.done["reload"] += 1
        self.events.append((at_s, lambda: self.world.daemons["run"].send_signal(signal.SIGHUP)))


def told(story: Story, minutes: float, rng: random.Random) -> Course:
    """Plan all events of so many minutes; return the link's course."""
    whole_s, share = 60.0 * minutes, minutes / 10.0
    kills = [names for names, many in KILLS[story.world.side.name].items() for _ in range(max(1, round(many * share)))]
    rng.shuffle(kills)
    slot_s = 0.6 * whole_s / len(kills)
    for k, names in enumerate(kills):
        story.kill(3.0 + slot_s * k, names)
    for k in range(max(1, round(10 * share))):
        story.reload(3.0 + slot_s * (k % len(kills)) + 0.7 * slot_s)
    starts_s = [0.0, *(rng.uniform(1.0, whole_s) for _ in range(round(whole_s / 10)))]
    rates = {at_s: _FAST if not at_s else math.exp(rng.uniform(math.log(_SLOW), math.log(_FAST))) for at_s in starts_s}
    outs = max(1, round(6 * share))
    spans = [(whole_s * (k + 0.5) / outs, whole_s * (k + 0.5) / outs + _OUT_S) for k in range(outs)]
    story.breaks += spans
    story.done["outage"] = outs

    def loss_at(at_s: float) -> float:
        if any(begin_s <= at_s < over_s for begin_s, over_s in spans):
            return 1.0
        return _LOSS if at_s >= 0.6 * whole_s else 0.0

    changes = sorted({*rates, 0.6 * whole_s, *(time_s for span in spans for time_s in span)})
    known = sorted(rates)
    return [(at_s, rates[known[bisect_right(known, at_s) - 1]], loss_at(at_s)) for at_s in changes]


def played(side: str, minutes: float, seed: int) -> dict[str, Any]:
    """Play one side's bad minutes, and return what became of samples, sets and calls."""
    robot = replace(ROBOT, groups=SETS if side == "two_ends" else ())
    with world_of(robot, SIDES[side], rate=_FAST) as world:
        story = Story(world=world)
        course = told(story, minutes, random.Random(seed))
        account, spent = world.play(course, 60.0 * minutes, events=story.events, drain_s=10.0)
        for thread in story.watching:
            thread.join(_PLANNED_S)
    breaks = [(account.from_s + begin_s, account.from_s + over_s) for begin_s, over_s in story.breaks]
    rows = []
    for name, row in account.topics.items():
        counts = {key.replace("_", " "): row[key] for key in ("published", "delivered", "doubled", "out_of_order")}
        rows.append(
            {"side": side, "topic": name, **counts, **account.missing(name, breaks), "longest gap s": row["gap_s"]}
        )
    took_s = [call["took_s"] for call in account.calls if call["answers"]]
    calls = {
        "side": side,
        "made": len(account.calls),
        "answered": len(took_s),
        "failed": sum(call["has_failed"] for call in account.calls),
        "answered twice": sum(call["answers"] > 1 for call in account.calls),
        "wrong": sum(call["is_wrong"] for call in account.calls),
        "ran twice": sum(many > 1 for many in account.ran.values()),
        "median s": median(took_s) if took_s else None,
        "longest s": max(took_s, default=None),
    }
    came = [{row[1] for row in account.arrivals[name]} for name in SETS]
    known = [value for value in story.planned_s if value is not None]
    counted = {
        "samples lost that nobody may thin, beside no break": sum(
            row["missing otherwise"] for row in rows if row["topic"] in _KEPT
        ),
        "samples doubled": sum(row["doubled"] for row in rows),
        "samples out of order": sum(row["out of order"] for row in rows),
        "topics that never flow again": sum(row["never again"] for row in rows),
        "sets that came in part": len(set.union(*came) - set.intersection(*came)) if robot.groups else 0,
        "calls answered twice, wrong or run twice": calls["answered twice"] + calls["wrong"] + calls["ran twice"],
        "processes that ended themselves": len(spent["ended"]),
    }
    back_s = max(known) if known and len(known) == len(story.planned_s) else None
    figures = [figure(f"{side}: {what}", many, most=0) for what, many in counted.items()]
    figures.append(figure(f"{side}: kill -9 of run until all is planned again, longest", back_s, "s", most=5.0))
    events = f"{side}: {', '.join(f'{many} × {what}' for what, many in story.done.items())}"
    return {"events": events, "figures": figures, "topics": rows, "calls": [calls]}


def play(*, is_quick: bool, rounds: int = 1) -> Summary:
    """Play both sides."""
    minutes = QUICK_MINUTES if is_quick else MINUTES * rounds
    runs = [played(side, minutes, seed) for seed, side in enumerate(KILLS)]

    def every(what: str) -> list[Any]:
        return [each for run in runs for each in run[what]]

    return Summary(
        about=f"{minutes:g} minutes each with the relay's two ends and with AdaptivePublishers. "
        f"{'; '.join(run['events'] for run in runs)}. Missing: beside a break, and otherwise, "
        "with what pacing withheld. A topic flows again so long after the end of a break.",
        figures=every("figures"),
        tables=[table("", every("topics")), table("Calls from the base, one after the other", every("calls"))],
    )
