"""Compare arpd's estimate with the truth as source of the capacity, on simulated links in virtual time."""

from __future__ import annotations

import logging
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product, takewhile
from random import Random
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.daemon.scenario import Moment, Scenario, ScenarioResult, Way
from arpd.daemon.summary import WARM_UP_S, between, summarize
from arpd.model.settings import TopicSettings
from arpd.sim.demo import demo_settings, demo_topics
from arpd.sim.link import CrossFlow, LinkModel
from arpd.sim.schedule import RateSchedule, outages
from scripts.bench.links import GOOD_S, MBIT, bursts, marks
from scripts.bench.report import Summary, figure, picked, table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

ARPD, BOUND = "arpd", "bound"
SEEDS, PROCESSES = 3, 2
_HOLDS_S = 1.0 - 1e-9
_QUEUE_BYTES = 1_500_000  # a thousand full packets, as a Linux interface queues: no queue is limited by room

#: The demo robot publishes 12 Mbit/s; with two more of its cameras 27, so that no link here carries everything.
CAMERA = next(topic for topic in demo_topics() if topic.name == "/camera/image/compressed")
BUSY = (*demo_topics(), *(replace(CAMERA, name=f"/camera/{side}/compressed") for side in ("left", "right")))
#: Floors that fit into 0.4 Mbit/s: the demo's alone exceed 1 Mbit/s, so its queue would not come from the estimate.
LOW_FLOORS = replace(
    demo_settings(),
    topics=(
        TopicSettings(name="/**", min_rate_hz=0.2),
        TopicSettings(name="/cmd_vel", weight=10.0, min_rate_hz=20.0),
        TopicSettings(name="/link/imu", weight=4.0, min_rate_hz=20.0),
        TopicSettings(name="/link/odom", weight=4.0, min_rate_hz=10.0),
    ),
)
Metrics = dict[str, float]


def _noisy(seed: int) -> RateSchedule:
    """Change the rate around 15 Mbit/s every 0.5 s: its logarithm is an AR(1), deviation 0.2, correlation 0.7."""
    random, level, course = Random(f"noisy {seed}"), 0.0, []
    for k in range(140):
        course.append((round(0.5 * k, 9), 15.0 * math.exp(level)))
        level = 0.7 * level + random.gauss(0.0, 0.2 * math.sqrt(1 - 0.7**2))
    return marks(course)


def _near_zero(seed: int) -> RateSchedule:
    """Hold 20 Mbit/s, fall to 0.25 within 4 s from 13 s on; for 50 s the rate is 0.01 to 0.25, another every second."""
    random = Random(f"near zero {seed}")
    leaving = ((13.0 + 0.2 * k, 20.0 / 80.0 ** (k / 20)) for k in range(20))
    weak = ((17.0 + k, 0.01 * 25.0 ** random.random()) for k in range(50))
    return marks(((0.0, 20.0), *leaving, *weak, (67.0, 20.0)))


def _on(duration_s: float, *course: tuple[float, float], **more: Any) -> Scenario:
    """Return a run on a link with another rate (Mbit/s) from each time on (s)."""
    return replace(Scenario(LOW_FLOORS, marks(course), duration_s, model=SEEN, topics=BUSY), **more)


def _change(before: float, after: float, duration_s: float = 28.0, **more: Any) -> Scenario:
    return _on(duration_s, (0.0, before), (13.0, after), **more)


def _oscillation(period_s: float, duration_s: float) -> Scenario:
    halves = range(math.ceil((duration_s - 12.0) / (period_s / 2)))
    return _on(duration_s, (0.0, 20.0), *((12.0 + k * period_s / 2, 20.0 if k % 2 else 5.0) for k in halves))


SEEN = LinkModel(queue_bytes=_QUEUE_BYTES)
UNSEEN = LinkModel(queue_bytes=0, firmware_bytes=_QUEUE_BYTES)  # in a Wi-Fi adapter's firmware, or an access point
_OUTAGES = ((15.0, 18.0), (26.0, 31.0), (39.0, 49.0))
_BURSTS = takewhile(lambda burst: burst[0] < 50.0, bursts(_RNG := Random("bursts"), _RNG.expovariate(1.0 / GOOD_S)))
_STALLS = tuple(mark for start_s, end_s in _OUTAGES for mark in ((start_s, 0.0), (end_s, 20.0)))
_DOWNLOAD = CrossFlow(start_s=0.0, end_s=1000.0, rate_bytes_per_second=40.0 * MBIT)
FALLS = {
    f"fall {before} to {after:g}": _change(before, after)
    for before, afters in ((20, (19, 16, 14, 12, 11, 10, 8, 6)), (5, (4.5, 3.5, 2.5, 1.5)))
    for after in afters
}
SCENARIOS: dict[str, Scenario] = {
    "steady 20": _on(70.0, (0.0, 20.0)),
    "steady 5": _on(70.0, (0.0, 5.0)),
    **FALLS,
    "fall 20 to 5": _change(20, 5),
    "fall 5 to 1": _change(5, 1),
    "fall 20 to 5, unseen": _change(20, 5, model=UNSEEN),
    "fall 5 to 1, unseen": _change(5, 1, model=UNSEEN),
    "fall 20 to 5, download": _change(20, 5, into_peer=(_DOWNLOAD,)),
    "fall 20 to 5, no peer": _change(20, 5, has_peer=False),
    "rise 5 to 20": _change(5, 20, 36.0),
    "noisy": _on(70.0, (0.0, 15.0)),
    "bursts": _on(50.0, (0.0, 20.0), model=replace(SEEN, losses=outages(*_BURSTS))),
    "outages, lost": _on(57.0, (0.0, 20.0), model=replace(SEEN, losses=outages(*_OUTAGES))),
    "outages, stalled": _on(57.0, (0.0, 20.0), *_STALLS),
    "app-limited": _on(35.0, (0.0, 20.0), topics=demo_topics()),
    "near zero": _on(75.0, (0.0, 20.0)),
    "oscillation 2 s": _oscillation(2.0, 32.0),
    "oscillation 5 s": _oscillation(5.0, 42.0),
    "oscillation 8 s": _oscillation(8.0, 52.0),
}
_RANDOM = {"noisy": _noisy, "near zero": _near_zero}  # links that the seed makes
chosen = partial(picked, SCENARIOS)
QUICK = ("steady 20", "fall 20 to 5", "rise 5 to 20", "outages, lost")


def measure(name: str, result: ScenarioResult, bound: ScenarioResult) -> Metrics:
    """Return the figures of a run; the window is from 10 s to the end.

    An event that never happens is infinite: the time from a fall until the estimate is within 15 % of the new truth, or
    the budget at most a tenth above it, from a rise until the estimate is above 80 % of it, each for a second; from an
    outage until the budget is at most a tenth, and from its end until half a second delivers 80 % of what came before.
    """

    def ratio(moment: Moment) -> float:
        return (moment.estimate_bytes_per_second or 0.0) / moment.truth_bytes_per_second

    run = SCENARIOS[name]
    ours, theirs = (summarize(each, start_s=WARM_UP_S, end_s=run.duration_s) for each in (result, bound))
    found = {
        "error p90": ours.error_p90 or 0.0,
        "goodput": ours.goodput_bytes_per_second / theirs.goodput_bytes_per_second,
        "queue p99 s": ours.queue_p99_s,
        "queue max s": ours.queue_peak_s,
        "plans/min": ours.plans_per_minute,
        "probes": ours.measuring_share,
    }
    if len(run.schedule.steps) == 2:
        after = between(result.moments, run.schedule.duration_s, run.duration_s)
        if after[-1].truth_bytes_per_second > result.moments[0].truth_bytes_per_second:
            found["estimate rises s"] = _until(after, lambda one: ratio(one) > 0.8)
        else:
            found["estimate falls s"] = _until(after, lambda one: abs(ratio(one) - 1.0) <= 0.15)
            found["budget falls s"] = _until(after, lambda one: _budget(one) <= 1.1 * one.truth_bytes_per_second)
    return found | (_outages(result.moments) if name in _OUT else {})


def _outages(moments: Sequence[Moment]) -> Metrics:
    """Return the worst of the outages."""
    closed, recovery = [], []
    for (start_s, end_s), (next_s, _) in zip(_OUTAGES, (*_OUTAGES[1:], (math.inf, 0.0)), strict=True):
        before = between(moments, start_s - 5.0, start_s)
        little = 0.1 * _budget(before[-1])
        shut = (one.t_s - start_s for one in between(moments, start_s, end_s) if _budget(one) <= little)
        closed.append(next(shut, math.inf))
        mean = (before[-1].delivered_bytes - before[0].delivered_bytes) / (before[-1].t_s - before[0].t_s)
        back = (
            one.t_s - end_s
            for past, one in zip(moments, moments[5:], strict=False)  # half a second later
            if end_s < one.t_s < next_s
            and one.delivered_bytes - past.delivered_bytes > 0.8 * mean * (one.t_s - past.t_s)
        )
        recovery.append(next(back, math.inf))
    return {"budget closes s": max(closed), "flows again s": max(recovery)}


def _budget(moment: Moment) -> float:
    return math.inf if moment.budget_bytes_per_second is None else moment.budget_bytes_per_second


def _until(moments: Sequence[Moment], holds: Callable[[Moment], bool]) -> float:
    """Return when something begins to hold for a second, from the first moment on; infinite = never (s)."""
    began_s: float | None = None
    for moment in moments:
        began_s = (moment.t_s if began_s is None else began_s) if holds(moment) else None
        if began_s is not None and moment.t_s - began_s >= _HOLDS_S:
            return began_s - moments[0].t_s
    return math.inf


_DROPS = ("fall 20 to 5", "fall 20 to 5, unseen")
_STEADY, _OUT = ("steady 20", "steady 5"), ("outages, lost", "outages, stalled")
_SWINGS = ("oscillation 2 s", "oscillation 5 s", "oscillation 8 s")
#: What, figure, unit, scenarios (none = all), and the most for the median and for the worst seed; the least, where the
#: unit has a minus. A unit with % takes the figure a hundred times.
TARGETS: tuple[tuple[str, str, str, tuple[str, ...], tuple[float, float]], ...] = (
    ("falls to 0.3 to 0.95 of the rate: estimate follows", "estimate falls s", "s", tuple(FALLS), (0.6, 1.5)),
    ("20→5: estimate follows", "estimate falls s", "s", _DROPS, (0.6, 1.5)),
    ("20→5: budget follows", "budget falls s", "s", _DROPS, (0.6, 1.5)),
    ("20→5: longest queue", "queue max s", "s", _DROPS, (0.6, 0.6)),
    ("5→1: longest queue", "queue max s", "s", ("fall 5 to 1", "fall 5 to 1, unseen"), (1.0, 1.0)),
    ("5→20: estimate follows", "estimate rises s", "s", ("rise 5 to 20",), (1.0, 1.0)),
    ("steady: error of the estimate, p90", "error p90", "%", _STEADY, (10.0, 10.0)),
    ("steady: share of the bound's goodput", "goodput", "-%", _STEADY, (95.0, 95.0)),
    ("steady: plans", "plans/min", "/min", _STEADY, (0.2, 0.2)),
    ("noisy: plans", "plans/min", "/min", ("noisy",), (1.0, 1.0)),
    ("any scenario: plans", "plans/min", "/min", (), (6.0, 6.0)),
    ("any scenario: share of the capacity for probes and reports", "probes", "%", (), (1.0, 1.0)),
    ("outage: budget closed", "budget closes s", "s", _OUT, (0.5, 0.5)),
    ("outage: delivery recovers to 80 %", "flows again s", "s", _OUT, (5.0, 5.0)),
    ("near zero: queue p99", "queue p99 s", "s", ("near zero",), (2.0, 2.0)),
    ("bursts: share of the bound's goodput", "goodput", "-%", ("bursts",), (75.0, 75.0)),
    ("oscillations: share of the bound's goodput", "goodput", "-%", _SWINGS, (92.0, 92.0)),
)


def _one(key: tuple[str, int]) -> dict[tuple[str, str], Metrics]:
    """Play one scenario with one seed; return the figures of every way."""
    name, seed = key
    run = replace(SCENARIOS[name], seed=seed)
    if name in _RANDOM:
        run = replace(run, schedule=_RANDOM[name](seed))
    bound, arpd = (replace(run, way=way).play() for way in (Way.ORACLE, Way.ARPD))
    return {(name, ARPD): measure(name, arpd, bound), (name, BOUND): measure(name, bound, bound)}


def play(*, is_quick: bool, only: str = "", rounds: int = 1) -> Summary:
    """Play scenarios, each with several seeds."""
    seeds = 2 if is_quick else SEEDS * rounds
    names = picked(QUICK if is_quick else SCENARIOS, only)
    found: dict[tuple[str, str], list[Metrics]] = {}
    with ProcessPoolExecutor(PROCESSES, initializer=logging.disable) as pool:
        for ways in pool.map(_one, product(names, range(1, seeds + 1))):
            for row, metrics in ways.items():
                found.setdefault(row, []).append(metrics)
    return summary(found, seeds)


def summary(found: Mapping[tuple[str, str], Sequence[Metrics]], seeds: int) -> Summary:
    def of(way: str, key: str, names: Sequence[str]) -> list[float]:
        rows = (each for (name, by), each in found.items() if by == way and (not names or name in names))
        return [one[key] for each in rows for one in each if key in one]

    figures = []
    for what, key, unit, names, limits in TARGETS:
        is_least, factor = "-" in unit, 100.0 if "%" in unit else 1.0
        values, bounds = ([factor * each for each in of(way, key, names)] for way in (ARPD, BOUND))
        worst: Callable[[list[float]], float] = min if is_least else max
        for kind, over, limit in (("median", median, limits[0]), ("worst", worst, limits[1])) if values else ():
            target = {"least" if is_least else "most": limit}
            figures.append(figure(f"{what}, {kind}", over(values), unit.lstrip("-"), bound=over(bounds), **target))
    keys = list(dict.fromkeys(key for each in found.values() for one in each for key in one))
    rows: list[dict[str, Any]] = [
        {"scenario": name, "way": way} | {key: median(all_) if (all_ := of(way, key, (name,))) else "" for key in keys}
        for name, way in found
    ]
    return Summary(
        about=f"Scenarios in virtual time, {seeds} seeds. The bound is told the truth at every tick: rate and cross "
        "traffic, averaged over the next 0.2 s, and the queue. Error of the estimate, and probes with their reports: "
        "shares of the capacity; goodput: of the bound's; times: from a change of the link until arpd follows.",
        figures=figures,
        tables=[table("Medians of every scenario", rows)],
    )
