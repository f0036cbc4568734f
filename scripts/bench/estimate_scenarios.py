"""The links and robots of `scripts/bench/estimate.py`; all randomness comes from the seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from random import Random
from typing import TYPE_CHECKING, Any

from arpd.adapters.sim.demo import demo_settings, demo_topics
from arpd.adapters.sim.foreign import Contention, ForeignFlow, contended
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.loss import GilbertElliott
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.trace import read_trace
from arpd.model.endpoints import Direction
from arpd.model.settings import Settings, TopicSettings
from arpd.model.wire import wire_size
from scripts.bench.adapt_walk import TRACE
from scripts.bench.estimate_cellular import cellular

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

MBIT = 125_000.0  # bytes

#: A thousand full packets, as a Linux interface queues (txqueuelen 1000): deep enough that no queue is limited by room.
#: At 5 Mbit/s that is 2.4 s, at 1 Mbit/s 12 s.
QUEUE_BYTES = 1_500_000

#: The same queue out of this host's sight: in a Wi-Fi adapter's firmware, or in an access point.
UNSEEN_QUEUE = LinkModel(queue_bytes=0, firmware_bytes=QUEUE_BYTES)

#: The demo robot publishes 12 Mbit/s; with two more of its cameras 27, so that no link here carries everything.
CAMERA = next(topic for topic in demo_topics() if topic.name == "/camera/image/compressed")
BUSY_ROBOT = (*demo_topics(), *(replace(CAMERA, name=f"/camera/{side}/compressed") for side in ("left", "right")))
#: Without its camera it publishes 4 Mbit/s.
LIGHT_ROBOT = tuple(topic for topic in demo_topics() if topic is not CAMERA)
#: The demo robot's weights, and floors that fit into 0.4 Mbit/s: the demo's floors alone exceed a link of 1 Mbit/s, so
#: its queue would come from the floors and not from the estimate.
LOW_FLOORS = replace(
    demo_settings(),
    default_topic=TopicSettings(min_rate_hz=0.2),
    topics={
        "/cmd_vel": TopicSettings(weight=10.0, min_rate_hz=20.0),
        "/link/imu": TopicSettings(weight=4.0, min_rate_hz=20.0),
        "/link/odom": TopicSettings(weight=4.0, min_rate_hz=10.0),
    },
)
#: Twelve topics of 100 bytes at 200 Hz: 2,400 samples/s, and no sample is a train by itself.
SMALL_ROBOT = (
    *(SimTopic(name=f"/small/{i}", payload_bytes=100, rate_hz=200.0) for i in range(11)),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=20.0, direction=Direction.ACTUATION),
)
#: Grid maps of 2 MB for a planner on the robot; nobody on the other host reads them.
LOCAL_MAP = SimTopic(name="/map", payload_bytes=2_000_000, rate_hz=2.0, direction=Direction.LOCAL)


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One link, one robot, and the times of the figures.

    Parameters
    ----------
    schedule : rate of the link, from the seed
    model : other properties of the link
    foreign : cross traffic
    into_peer : a download of the peer, which does not cross this link
    has_peer : whether a peer receives probes and sends reports
    falls, rises : times of changes with a figure of their own (run time, s)
    lows : spans in which the link carries next to nothing (run time, s, s)
    outages : spans in which nothing arrives (run time, s, s)
    has_fluid : whether the fluid controller plays it, too
    """

    duration_s: float
    schedule: Callable[[int], RateSchedule]
    model: LinkModel = LinkModel(queue_bytes=QUEUE_BYTES)  # noqa: RUF009 - frozen
    foreign: tuple[ForeignFlow, ...] = ()
    into_peer: tuple[ForeignFlow, ...] = ()
    has_peer: bool = True
    robot: tuple[SimTopic, ...] = BUSY_ROBOT
    settings: Settings = LOW_FLOORS
    falls: tuple[float, ...] = ()
    rises: tuple[float, ...] = ()
    lows: tuple[tuple[float, float], ...] = ()
    outages: tuple[tuple[float, float], ...] = ()
    has_fluid: bool = False

    @property
    def demand_bytes_per_second(self) -> float:
        """Wire bytes that the robot's sensors would put on a link that carries everything (bytes/s)."""
        return sum(
            topic.rate_hz * wire_size(topic.payload_bytes, rate_hz=topic.rate_hz)[0]
            for topic in self.robot
            if topic.direction is Direction.SENSING
        )


def steps(text: str) -> Callable[[int], RateSchedule]:
    schedule = RateSchedule.parse(text)
    return lambda _seed: schedule


def of_rates(rates_mbit: list[float], every_s: float) -> RateSchedule:
    steps_of = ((round(k * every_s, 9), rate * MBIT) for k, rate in enumerate(rates_mbit))
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate) for at_s, rate in steps_of))


def ramp(_seed: int) -> RateSchedule:
    """Hold 20 Mbit/s for 12 s, fall evenly to 4 within 26 s, and rise as evenly."""
    falling = [20.0 - 16.0 * k / 52 for k in range(52)]
    return of_rates([20.0] * 24 + falling + falling[::-1], 0.5)


def noisy(seed: int) -> RateSchedule:
    """Change the rate around 15 Mbit/s every 0.5 s: its logarithm is an AR(1), deviation 0.2, correlation 0.7."""
    random = Random(f"noisy {seed}")
    deviation, correlation = 0.2, 0.7
    level, rates = 0.0, []
    for _ in range(140):
        rates.append(15.0 * math.exp(level))
        level = correlation * level + random.gauss(0.0, deviation * math.sqrt(1 - correlation**2))
    return of_rates(rates, 0.5)


def busy_air(seed: int) -> RateSchedule:
    """Hold 20 Mbit/s; from 13 to 33 s a station takes 60 % of the air time, in bursts and pauses of 0.1 to 1 s."""
    random = Random(f"air {seed}")
    stations, at_s = [], 13.0
    while at_s < 33.0:
        end_s = at_s + random.uniform(0.1, 1.0)
        stations.append(Contention(start_s=at_s, end_s=end_s, share=0.6))
        at_s = end_s + random.uniform(0.1, 1.0)
    return contended(RateSchedule.parse("0:20mbit"), stations)


def oscillation(period_s: float, duration_s: float) -> Callable[[int], RateSchedule]:
    """Alternate 20 and 5 Mbit/s, each for half of the period; the first 12 s stay at 20."""
    halves = math.ceil((duration_s - 12.0) / (period_s / 2))
    return _at((12.0 + k * period_s / 2, 5.0 if k % 2 == 0 else 20.0) for k in range(halves))


def stalling(spans: tuple[tuple[float, float], ...]) -> Callable[[int], RateSchedule]:
    """Hold 20 Mbit/s, without any service in the spans: what is sent then waits."""
    return _at(mark for start_s, end_s in spans for mark in ((start_s, 0.0), (end_s, 20.0)))


def near_zero(seed: int) -> RateSchedule:
    """Hold 20 Mbit/s, fall to 0.25 within 4 s from 13 s on; for 50 s the rate is 0.01 to 0.25, another every second."""
    random = Random(f"near zero {seed}")
    leaving = ((13.0 + 0.2 * k, 20.0 / 80.0 ** (k / 20)) for k in range(20))
    low = ((17.0 + k, 0.01 * 25.0 ** random.random()) for k in range(50))
    return _at((*leaving, *low, (67.0, 20.0)))(seed)


def _cellular(way: str) -> Callable[[int], RateSchedule]:
    return lambda seed: cellular(f"{way} {seed}", _CELLULAR_S)


def _fall(before: float, after: float, **more: Any) -> Scenario:
    """Hold one rate for 13 s, and then another (Mbit/s)."""
    return Scenario(duration_s=28.0, schedule=steps(f"0:{before:g}mbit,13:{after:g}mbit"), falls=(13.0,), **more)


def _at(marks: Iterable[tuple[float, float]]) -> Callable[[int], RateSchedule]:
    """Return a schedule that begins at 20 Mbit/s and has another rate (Mbit/s) from each time on (s)."""
    steps_of = [RateStep(start_s=at_s, rate_bytes_per_second=mbit * MBIT) for at_s, mbit in ((0.0, 20.0), *marks)]
    schedule = RateSchedule(steps=tuple(steps_of))
    return lambda _seed: schedule


_OUTAGES = ((15.0, 18.0), (26.0, 31.0), (39.0, 49.0))

_CELLULAR_S = 120.0
_WALK = read_trace(TRACE)
_DOWNLOAD = (ForeignFlow(start_s=0.0, end_s=1000.0, rate_bytes_per_second=40.0 * MBIT),)

#: Falls to 0.3 to 0.95 of the capacity, by name.
FALLS: dict[str, Scenario] = {
    f"fall {before} to {after:g}": _fall(before, after)
    for before, afters in ((20, (19, 16, 14, 12, 11, 10, 8, 6)), (5, (4.5, 3.5, 2.5, 1.5)))
    for after in afters
}

SCENARIOS: dict[str, Scenario] = {
    "steady 20": Scenario(duration_s=70.0, schedule=steps("0:20mbit")),
    "steady 5": Scenario(duration_s=70.0, schedule=steps("0:5mbit")),
    **FALLS,
    "fall 20 to 5": _fall(20, 5),
    "fall 5 to 1": Scenario(duration_s=36.0, schedule=steps("0:5mbit,13:1mbit"), falls=(13.0,)),
    "fall 20 to 5, unseen": _fall(20, 5, model=UNSEEN_QUEUE),
    "fall 5 to 1, unseen": Scenario(
        duration_s=36.0, schedule=steps("0:5mbit,13:1mbit"), model=UNSEEN_QUEUE, falls=(13.0,)
    ),
    "fall 20 to 5, local maps": _fall(20, 5, robot=(*BUSY_ROBOT, LOCAL_MAP)),
    "fall 20 to 5, download": _fall(20, 5, into_peer=_DOWNLOAD),
    "fall 20 to 5, no peer": _fall(20, 5, has_peer=False),
    "rise 5 to 20": Scenario(duration_s=36.0, schedule=steps("0:5mbit,13:20mbit"), rises=(13.0,)),
    "ramp": Scenario(duration_s=65.0, schedule=ramp),
    "noisy": Scenario(duration_s=70.0, schedule=noisy),
    **{
        f"bursts, {how} lost": Scenario(
            duration_s=50.0,
            schedule=steps("0:20mbit"),
            model=LinkModel(queue_bytes=QUEUE_BYTES, bursts=GilbertElliott(good_s=3.0, bad_s=0.3, bad_loss=bad_loss)),
        )
        for how, bad_loss in (("all", 1.0), ("half", 0.5))
    },
    "outages, lost": Scenario(
        duration_s=57.0,
        schedule=steps("0:20mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, outages=_OUTAGES),
        outages=_OUTAGES,
    ),
    "outages, stalled": Scenario(duration_s=57.0, schedule=stalling(_OUTAGES), outages=_OUTAGES),
    "near zero": Scenario(duration_s=75.0, schedule=near_zero, lows=((13.0, 67.0),)),
    **{
        f"oscillation {period_s:g} s": Scenario(
            duration_s=duration_s, schedule=oscillation(period_s, duration_s), has_fluid=True
        )
        for period_s, duration_s in ((2.0, 32.0), (5.0, 42.0), (8.0, 52.0))
    },
    "cellular up": Scenario(duration_s=_CELLULAR_S, schedule=_cellular("up"), has_fluid=True),
    "cellular down": Scenario(duration_s=_CELLULAR_S, schedule=_cellular("down"), has_fluid=True),
    "walk": Scenario(
        duration_s=28.0,
        schedule=lambda _seed: _WALK.rates,
        model=LinkModel(losses=_WALK.losses),
        robot=demo_topics(),
        settings=demo_settings(),
        has_fluid=True,
    ),
    "contention, same host": Scenario(
        duration_s=45.0,
        schedule=steps("0:20mbit"),
        foreign=(ForeignFlow(start_s=13.0, end_s=33.0, rate_bytes_per_second=8.0 * MBIT),),
    ),
    "contention, air": Scenario(duration_s=45.0, schedule=busy_air),
    "small messages": Scenario(
        duration_s=35.0,
        schedule=steps("0:5mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, packet_overhead_s=200e-6),
        robot=SMALL_ROBOT,
        settings=Settings(),
    ),
    "small, aggregated": Scenario(
        duration_s=35.0,
        schedule=steps("0:5mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, packet_overhead_s=200e-6, aggregate_packets=16),
        robot=SMALL_ROBOT,
        settings=Settings(),
    ),
    "app-limited": Scenario(duration_s=35.0, schedule=steps("0:20mbit"), robot=LIGHT_ROBOT),
}
