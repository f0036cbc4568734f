"""Compare arpd's estimate with the bound, on simulated links in virtual time.

Both govern the same robot through the daemon's own tick; only the source of the capacity differs. The bound is
told the truth at every tick: rate and cross traffic, averaged over the next 0.2 s, and the queue.
"""

from __future__ import annotations

import logging
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from random import Random
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.daemon import scenario as simulated
from arpd.daemon.summary import WARM_UP_S, between, summarize
from arpd.model.endpoints import Direction
from arpd.model.settings import Settings, TopicSettings
from arpd.sim.demo import demo_settings, demo_topics
from arpd.sim.link import ForeignFlow, LinkModel
from arpd.sim.result import SimTopic, percentile
from arpd.sim.schedule import LossStep, RateSchedule, RateStep, outages
from arpd.sim.trace import read_trace
from scripts.bench.harness import settled_s
from scripts.bench.links import GOOD_S, MBIT, WALK, bursts
from scripts.bench.report import Summary, figure, table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from arpd.daemon.scenario import Moment, ScenarioResult

ARPD, BOUND = "arpd", "bound"
SEEDS, PROCESSES = 3, 2
_QUEUE_BYTES = 1_500_000  # a thousand full packets, as a Linux interface queues: no queue is limited by room
_MOMENT_S, _DELIVERY_S = 0.1, 0.5

#: The demo robot publishes 12 Mbit/s; with two more of its cameras 27, so that no link here carries everything.
_CAMERA = next(topic for topic in demo_topics() if topic.name == "/camera/image/compressed")
_BUSY = (*demo_topics(), *(replace(_CAMERA, name=f"/camera/{side}/compressed") for side in ("left", "right")))
_LIGHT = tuple(topic for topic in demo_topics() if topic is not _CAMERA)
#: Floors that fit into 0.4 Mbit/s: the demo's alone exceed 1 Mbit/s, so its queue would not come from the estimate.
_LOW_FLOORS = replace(
    demo_settings(),
    topics=(
        TopicSettings(name="/**", min_rate_hz=0.2),
        TopicSettings(name="/cmd_vel", weight=10.0, min_rate_hz=20.0),
        TopicSettings(name="/link/imu", weight=4.0, min_rate_hz=20.0),
        TopicSettings(name="/link/odom", weight=4.0, min_rate_hz=10.0),
    ),
)
#: Grid maps of 2 MB for a planner on the robot; nobody on the other host reads them.
_LOCAL_MAP = SimTopic(name="/map", payload_bytes=2_000_000, rate_hz=2.0, direction=Direction.LOCAL)
_SMALL = (
    *(SimTopic(name=f"/small/{i}", payload_bytes=100, rate_hz=200.0) for i in range(11)),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=20.0, direction=Direction.ACTUATION),
)

Metrics = dict[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One link, one robot, and the times of the figures.

    Parameters
    ----------
    schedule : rate of the link, from the seed
    foreign, into_peer : cross traffic, and a download of the peer, which does not cross this link
    has_peer : whether a peer receives probes and sends reports
    change_s : time of a fall or rise with figures of its own (s)
    outages : spans in which nothing arrives (s, s)
    """

    duration_s: float
    schedule: Callable[[int], RateSchedule]
    model: LinkModel = LinkModel(queue_bytes=_QUEUE_BYTES)  # noqa: RUF009 - frozen
    foreign: tuple[ForeignFlow, ...] = ()
    into_peer: tuple[ForeignFlow, ...] = ()
    has_peer: bool = True
    robot: tuple[SimTopic, ...] = _BUSY
    settings: Settings = _LOW_FLOORS
    change_s: float | None = None
    outages: tuple[tuple[float, float], ...] = ()

    def play(self, way: str, seed: int) -> ScenarioResult:
        logging.disable(logging.CRITICAL)
        return simulated.Scenario(
            self.settings,
            self.schedule(seed),
            self.duration_s,
            seed=seed,
            model=self.model,
            foreign=self.foreign,
            into_peer=self.into_peer,
            has_peer=self.has_peer,
            topics=self.robot,
            way=simulated.Way.ORACLE if way == BOUND else simulated.Way.ARPD,
        ).play()


def _marks(marks: Iterable[tuple[float, float]]) -> RateSchedule:
    """Return a schedule with another rate (Mbit/s) from each time on (s)."""
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=mbit * MBIT) for at_s, mbit in marks))


def _steps(*marks: tuple[float, float]) -> Callable[[int], RateSchedule]:
    return lambda _seed: _marks(marks)


def _noisy(seed: int) -> RateSchedule:
    """Change the rate around 15 Mbit/s every 0.5 s: its logarithm is an AR(1), deviation 0.2, correlation 0.7."""
    random, level, marks = Random(f"noisy {seed}"), 0.0, []
    for k in range(140):
        marks.append((round(0.5 * k, 9), 15.0 * math.exp(level)))
        level = 0.7 * level + random.gauss(0.0, 0.2 * math.sqrt(1 - 0.7**2))
    return _marks(marks)


def _near_zero(seed: int) -> RateSchedule:
    """Hold 20 Mbit/s, fall to 0.25 within 4 s from 13 s on; for 50 s the rate is 0.01 to 0.25, another every second."""
    random = Random(f"near zero {seed}")
    leaving = ((13.0 + 0.2 * k, 20.0 / 80.0 ** (k / 20)) for k in range(20))
    return _marks(
        ((0.0, 20.0), *leaving, *((17.0 + k, 0.01 * 25.0 ** random.random()) for k in range(50)), (67.0, 20.0))
    )


def _oscillation(period_s: float, duration_s: float) -> Callable[[int], RateSchedule]:
    halves = range(math.ceil((duration_s - 12.0) / (period_s / 2)))
    return _steps((0.0, 20.0), *((12.0 + k * period_s / 2, 20.0 if k % 2 else 5.0) for k in halves))


def _cellular(seed: int) -> RateSchedule:
    """Return a link as Sprout models it (Winstein, Sivaraman, Balakrishnan, NSDI 2013, §3), over 120 s.

    Packets leave by a Poisson process whose rate is a Brownian motion, reflected at 0 and at 12 Mbit/s; near 0 begins
    an outage, which ends at a rate of its own. Deviation and rate of escape are the paper's.
    """
    random, step_s, most = Random(f"cellular up {seed}"), 0.02, 1000.0
    rate, marks = random.uniform(0.0, most), list[tuple[float, float]]()
    for k in range(round(120.0 / step_s) + 1):
        if rate > 0.0 or random.random() < -math.expm1(-step_s):
            rate = abs(rate + random.gauss(0.0, 200.0 * math.sqrt(step_s)))
            rate = min(rate, 2.0 * most - rate)
            rate = rate if rate >= most / 256 else 0.0
        packets, waited = 0, random.expovariate(1.0)
        while waited < rate * step_s:
            packets, waited = packets + 1, waited + random.expovariate(1.0)
        carried = packets * 1500 * 8e-6 / step_s
        if not marks or carried != marks[-1][1]:
            marks.append((round(k * step_s, 9), carried))
    return _marks([*marks, (121.0, 12.0)])  # what waits at the end must leave


def _bursts(duration_s: float) -> tuple[LossStep, ...]:
    """Lose everything in bursts; the first one comes when it may."""
    random = Random("bursts")
    begun = takewhile(lambda burst: burst[0] < duration_s, bursts(random, random.expovariate(1.0 / GOOD_S)))
    return tuple(step for begin_s, end_s in begun for step in (LossStep(begin_s, 1.0), LossStep(end_s, 0.0)))


def _fall(before: float, after: float, **more: Any) -> Scenario:
    return Scenario(duration_s=28.0, schedule=_steps((0.0, before), (13.0, after)), change_s=13.0, **more)


_UNSEEN = LinkModel(queue_bytes=0, firmware_bytes=_QUEUE_BYTES)  # in a Wi-Fi adapter's firmware, or an access point
_OUTAGES = ((15.0, 18.0), (26.0, 31.0), (39.0, 49.0))
_STALLS = tuple(mark for start_s, end_s in _OUTAGES for mark in ((start_s, 0.0), (end_s, 20.0)))
_FOREVER = partial(ForeignFlow, start_s=0.0, end_s=1000.0)
_TRACE = read_trace(WALK)
FALLS = {
    f"fall {before} to {after:g}": _fall(before, after)
    for before, afters in ((20, (19, 16, 14, 12, 11, 10, 8, 6)), (5, (4.5, 3.5, 2.5, 1.5)))
    for after in afters
}
SCENARIOS: dict[str, Scenario] = {
    "steady 20": Scenario(duration_s=70.0, schedule=_steps((0.0, 20.0))),
    "steady 5": Scenario(duration_s=70.0, schedule=_steps((0.0, 5.0))),
    **FALLS,
    "fall 20 to 5": _fall(20, 5),
    "fall 5 to 1": _fall(5, 1),
    "fall 20 to 5, unseen": _fall(20, 5, model=_UNSEEN),
    "fall 5 to 1, unseen": _fall(5, 1, model=_UNSEEN),
    "fall 20 to 5, local maps": _fall(20, 5, robot=(*_BUSY, _LOCAL_MAP)),
    "fall 20 to 5, download": _fall(20, 5, into_peer=(_FOREVER(rate_bytes_per_second=40.0 * MBIT),)),
    "fall 20 to 5, no peer": _fall(20, 5, has_peer=False),
    "rise 5 to 20": replace(_fall(5, 20), duration_s=36.0),
    "noisy": Scenario(duration_s=70.0, schedule=_noisy),
    "bursts": Scenario(
        duration_s=50.0,
        schedule=_steps((0.0, 20.0)),
        model=LinkModel(queue_bytes=_QUEUE_BYTES, losses=_bursts(50.0)),
    ),
    "outages, lost": Scenario(
        duration_s=57.0,
        schedule=_steps((0.0, 20.0)),
        model=LinkModel(queue_bytes=_QUEUE_BYTES, losses=outages(*_OUTAGES)),
        outages=_OUTAGES,
    ),
    "outages, stalled": Scenario(duration_s=57.0, schedule=_steps((0.0, 20.0), *_STALLS), outages=_OUTAGES),
    "near zero": Scenario(duration_s=75.0, schedule=_near_zero),
    **{
        f"oscillation {period_s:g} s": Scenario(duration_s=duration_s, schedule=_oscillation(period_s, duration_s))
        for period_s, duration_s in ((2.0, 32.0), (5.0, 42.0), (8.0, 52.0))
    },
    "cellular": Scenario(duration_s=120.0, schedule=_cellular),
    "walk": Scenario(
        duration_s=28.0,
        schedule=lambda _seed: _TRACE.rates,
        model=LinkModel(losses=_TRACE.losses),
        robot=demo_topics(),
        settings=demo_settings(),
    ),
    "contention, same host": Scenario(
        duration_s=45.0,
        schedule=_steps((0.0, 20.0)),
        foreign=(ForeignFlow(start_s=13.0, end_s=33.0, rate_bytes_per_second=8.0 * MBIT),),
    ),
    **{
        f"small messages, aggregates of {many}": Scenario(
            duration_s=35.0,
            schedule=_steps((0.0, 5.0)),
            model=LinkModel(queue_bytes=_QUEUE_BYTES, packet_overhead_s=200e-6, aggregate_packets=many),
            robot=_SMALL,
            settings=Settings(),
        )
        for many in (1, 16)
    },
    "app-limited": Scenario(duration_s=35.0, schedule=_steps((0.0, 20.0)), robot=_LIGHT),
}
QUICK = ("steady 20", "fall 20 to 5", "rise 5 to 20", "outages, lost")


def measure(scenario: Scenario, result: ScenarioResult, bound: ScenarioResult) -> Metrics:
    """Return the figures of a run; the window is from 10 s to the end, and times without service do not count.

    An event that never happens is infinite: the time from a fall until the estimate is within 15 % of the new truth, or
    the budget at most a tenth above it, from a rise until the estimate is above 80 % of it, each for a second; from an
    outage until the budget is at most a tenth, and from its end until half a second delivers 80 % of what came before.
    """
    end_s = scenario.duration_s
    served = [one for one in between(result.moments, WARM_UP_S, end_s) if one.truth_bytes_per_second > 0]
    ours, theirs = (summarize(each, start_s=WARM_UP_S, end_s=end_s) for each in (result, bound))
    queues = [one.queue_delay_s for one in served]
    off = [abs(_estimate(one) / one.truth_bytes_per_second - 1.0) for one in served if _estimate(one)]
    found = {
        "error p90": percentile(off, 0.9) or 0.0,
        "goodput": ours.goodput_bytes_per_second / theirs.goodput_bytes_per_second,
        "carried": ours.carried_share,
        "queue p50": percentile(queues, 0.5) or 0.0,
        "queue p99": percentile(queues, 0.99) or 0.0,
        "queue peak": max(queues),
        "lost": float(sum(topic.lost for topic in result.topics)),
        "plans": ours.plans_per_minute,
        "swaps": ours.swaps_per_minute,
        "measuring": ours.measuring_share,
    }
    if scenario.change_s is not None:
        after = between(result.moments, scenario.change_s, end_s)
        if after[-1].truth_bytes_per_second > result.moments[0].truth_bytes_per_second:
            found["rise"] = _until(after, lambda one: _estimate(one) > 0.8 * one.truth_bytes_per_second)
        else:
            found["reaction"] = _until(after, lambda one: abs(_estimate(one) / one.truth_bytes_per_second - 1) <= 0.15)
            found["budget"] = _until(after, lambda one: _budget(one) <= 1.1 * one.truth_bytes_per_second)
    if scenario.outages:
        found |= _outages(scenario, result.moments)
    return found


def _outages(scenario: Scenario, moments: Sequence[Moment]) -> Metrics:
    """Return the worst of the outages."""
    closed, recovery = [], []
    nexts_s = [start_s for start_s, _ in scenario.outages[1:]] + [scenario.duration_s]
    window = round(_DELIVERY_S / _MOMENT_S)
    for (start_s, end_s), next_s in zip(scenario.outages, nexts_s, strict=True):
        before = between(moments, start_s - 5.0, start_s)
        little = 0.1 * _budget(before[-1])
        shut = (one.t_s - start_s for one in between(moments, start_s, end_s) if _budget(one) <= little)
        closed.append(next(shut, math.inf))
        mean = (before[-1].delivered_bytes - before[0].delivered_bytes) / (before[-1].t_s - before[0].t_s)
        back = (
            one.t_s - end_s
            for past, one in zip(moments, moments[window:], strict=False)
            if end_s < one.t_s < next_s
            and one.delivered_bytes - past.delivered_bytes > 0.8 * mean * (one.t_s - past.t_s)
        )
        recovery.append(next(back, math.inf))
    return {"closed": max(closed), "recovery": max(recovery)}


def _estimate(moment: Moment) -> float:
    return moment.estimate_bytes_per_second or 0.0


def _budget(moment: Moment) -> float:
    return math.inf if moment.budget_bytes_per_second is None else moment.budget_bytes_per_second


def _until(moments: Sequence[Moment], holds: Callable[[Moment], bool]) -> float:
    since_s = settled_s((moment.t_s - moments[0].t_s, holds(moment)) for moment in moments)
    return math.inf if since_s is None else since_s


_DROPS = ("fall 20 to 5", "fall 20 to 5, unseen")
_STEADY, _OUT = ("steady 20", "steady 5"), ("outages, lost", "outages, stalled")
_SWINGS = ("oscillation 2 s", "oscillation 5 s", "oscillation 8 s")
_ANY = math.inf
#: What, figure, unit, scenarios (none = all), and the most for the median and for the worst seed; the least, where the
#: unit has a minus. A unit with % takes the figure a hundred times.
TARGETS: tuple[tuple[str, str, str, tuple[str, ...], tuple[float, float]], ...] = (
    ("falls to 0.3 to 0.95: estimate follows", "reaction", "s", tuple(FALLS), (0.6, 1.5)),
    ("20→5: estimate follows", "reaction", "s", _DROPS, (0.6, 1.5)),
    ("20→5: budget follows", "budget", "s", _DROPS, (0.6, 1.5)),
    ("20→5: longest queue", "queue peak", "s", _DROPS, (0.6, 0.6)),
    ("5→1: longest queue", "queue peak", "s", ("fall 5 to 1", "fall 5 to 1, unseen"), (1.0, 1.0)),
    ("5→20: estimate follows", "rise", "s", ("rise 5 to 20",), (1.0, 1.0)),
    ("steady: error of the estimate, p90", "error p90", "%", _STEADY, (10.0, 10.0)),
    ("steady: share of the bound's goodput", "goodput", "-%", _STEADY, (95.0, 95.0)),
    ("steady: plans", "plans", "/min", _STEADY, (0.2, 0.2)),
    ("noisy: plans", "plans", "/min", ("noisy",), (1.0, 1.0)),
    ("any scenario: plans", "plans", "/min", (), (6.0, 6.0)),
    ("any scenario: probes and reports of the capacity", "measuring", "%", (), (1.0, 1.0)),
    ("outage: budget closed", "closed", "s", _OUT, (0.5, 0.5)),
    ("outage: delivery recovers to 80 %", "recovery", "s", _OUT, (5.0, 5.0)),
    ("near zero: queue p99", "queue p99", "s", ("near zero",), (2.0, 2.0)),
    ("bursts: share of the bound's goodput", "goodput", "-%", ("bursts",), (75.0, 75.0)),
    ("oscillations: share of the bound's goodput", "goodput", "-%", _SWINGS, (92.0, 92.0)),
    ("oscillations: queue p99", "queue p99", "s", _SWINGS, (_ANY, _ANY)),
    ("cellular: share of the bound's goodput", "goodput", "-%", ("cellular",), (85.0, 85.0)),
    ("walk: samples lost", "lost", "", ("walk",), (_ANY, _ANY)),
)


def _one(key: tuple[str, int]) -> dict[str, Metrics]:
    """Play one scenario with one seed; return the figures of every way."""
    name, seed = key
    scenario = SCENARIOS[name]
    bound = scenario.play(BOUND, seed)
    return {ARPD: measure(scenario, scenario.play(ARPD, seed), bound), BOUND: measure(scenario, bound, bound)}


def play(*, is_quick: bool, only: str = "", rounds: int = 1) -> Summary:
    """Play scenarios, each with several seeds."""
    names = [name for name in (QUICK if is_quick else SCENARIOS) if only in name]
    seeds = 2 if is_quick else SEEDS * rounds
    keys = [(name, seed) for name in names for seed in range(1, seeds + 1)]
    found: dict[str, dict[str, list[Metrics]]] = {}
    with ProcessPoolExecutor(PROCESSES) as pool:
        for (name, _), ways in zip(keys, pool.map(_one, keys), strict=True):
            for way, metrics in ways.items():
                found.setdefault(name, {}).setdefault(way, []).append(metrics)
    return summary(found, seeds)


def summary(found: Mapping[str, Mapping[str, list[Metrics]]], seeds: int) -> Summary:
    def of(way: str, key: str, names: Sequence[str]) -> list[float]:
        return [one[key] for name in names or found for one in found.get(name, {}).get(way, []) if key in one]

    figures = []
    for what, key, unit, names, limits in TARGETS:
        is_least, factor = "-" in unit, 100.0 if "%" in unit else 1.0
        values, bounds = ([factor * each for each in of(way, key, names)] for way in (ARPD, BOUND))
        worst: Callable[[list[float]], float] = min if is_least else max
        for kind, over, limit in (("median", median, limits[0]), ("worst", worst, limits[1])) if values else ():
            target = {"least" if is_least else "most": limit}
            figures.append(figure(f"{what}, {kind}", over(values), unit.lstrip("-"), bound=over(bounds), **target))
    rows = [(name, way) for name, ways in found.items() for way in ways]
    keys = list(dict.fromkeys(key for ways in found.values() for each in ways.values() for one in each for key in one))

    def cell(row: tuple[str, str], key: str) -> float | str:
        values = of(row[1], key, (row[0],))
        return median(values) if values else ""

    return Summary(
        about=f"Scenarios in virtual time, {seeds} seeds. The bound is told the truth at every tick: rate and cross "
        "traffic, averaged over the next 0.2 s, and the queue.",
        figures=figures,
        tables=[
            table(
                "Medians of every scenario: times in s, per minute, shares of the bound's goodput and of the capacity",
                rows,
                ("scenario", lambda row: row[0]),
                ("way", lambda row: row[1]),
                *((key, lambda row, key=key: cell(row, key)) for key in keys),
            )
        ],
    )
