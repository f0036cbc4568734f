"""The links and robots of `scripts/bench/estimate.py`; all randomness comes from the seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from random import Random
from typing import TYPE_CHECKING

from arpd.adapters.sim.demo import demo_settings, demo_topics
from arpd.adapters.sim.foreign import Contention, ForeignFlow, contended
from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.loss import GilbertElliott
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.model.endpoints import Direction
from arpd.model.settings import Settings, TopicSettings

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


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One link, one robot, and the times of the figures.

    Parameters
    ----------
    schedule : rate of the link, from the seed
    model : other properties of the link
    foreign : cross traffic
    falls, rises : times of changes with a figure of their own (run time, s)
    outages : spans in which nothing arrives (run time, s, s)
    """

    duration_s: float
    schedule: Callable[[int], RateSchedule]
    model: LinkModel = LinkModel(queue_bytes=QUEUE_BYTES)  # noqa: RUF009 - frozen
    foreign: tuple[ForeignFlow, ...] = ()
    robot: tuple[SimTopic, ...] = BUSY_ROBOT
    falls: tuple[float, ...] = ()
    rises: tuple[float, ...] = ()
    outages: tuple[tuple[float, float], ...] = ()

    @property
    def settings(self) -> Settings:
        return Settings() if self.robot is SMALL_ROBOT else LOW_FLOORS


def steps(text: str) -> Callable[[int], RateSchedule]:
    schedule = RateSchedule.parse(text)
    return lambda _seed: schedule


def of_rates(rates_mbit: list[float], every_s: float) -> RateSchedule:
    steps_of = ((round(k * every_s, 9), rate * MBIT) for k, rate in enumerate(rates_mbit))
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate) for at_s, rate in steps_of))


def ramp(_seed: int) -> RateSchedule:
    """Hold 20 Mbit/s for 20 s, fall evenly to 4 within 40 s, and rise as evenly."""
    falling = [20.0 - 16.0 * k / 80 for k in range(80)]
    return of_rates([20.0] * 40 + falling + falling[::-1], 0.5)


def noisy(seed: int) -> RateSchedule:
    """Change the rate around 15 Mbit/s every 0.5 s: its logarithm is an AR(1), deviation 0.2, correlation 0.7."""
    random = Random(f"noisy {seed}")
    deviation, correlation = 0.2, 0.7
    level, rates = 0.0, []
    for _ in range(260):
        rates.append(15.0 * math.exp(level))
        level = correlation * level + random.gauss(0.0, deviation * math.sqrt(1 - correlation**2))
    return of_rates(rates, 0.5)


def busy_air(seed: int) -> RateSchedule:
    """Hold 20 Mbit/s; from 20 to 40 s a station takes 60 % of the air time, in bursts and pauses of 0.1 to 1 s."""
    random = Random(f"air {seed}")
    stations, at_s = [], 20.0
    while at_s < 40.0:
        end_s = at_s + random.uniform(0.1, 1.0)
        stations.append(Contention(start_s=at_s, end_s=end_s, share=0.6))
        at_s = end_s + random.uniform(0.1, 1.0)
    return contended(RateSchedule.parse("0:20mbit"), stations)


def oscillation(period_s: float, duration_s: float) -> Callable[[int], RateSchedule]:
    """Alternate 20 and 5 Mbit/s, each for half of the period; the first 20 s stay at 20."""
    halves = math.ceil((duration_s - 20.0) / (period_s / 2))
    return _at((20.0 + k * period_s / 2, 5.0 if k % 2 == 0 else 20.0) for k in range(halves))


def stalling(spans: tuple[tuple[float, float], ...]) -> Callable[[int], RateSchedule]:
    """Hold 20 Mbit/s, without any service in the spans: what is sent then waits."""
    return _at(mark for start_s, end_s in spans for mark in ((start_s, 0.0), (end_s, 20.0)))


def _at(marks: Iterable[tuple[float, float]]) -> Callable[[int], RateSchedule]:
    """Return a schedule that begins at 20 Mbit/s and has another rate (Mbit/s) from each time on (s)."""
    steps_of = [RateStep(start_s=at_s, rate_bytes_per_second=mbit * MBIT) for at_s, mbit in ((0.0, 20.0), *marks)]
    schedule = RateSchedule(steps=tuple(steps_of))
    return lambda _seed: schedule


_OUTAGES = ((20.0, 23.0), (38.0, 43.0), (58.0, 68.0))

SCENARIOS: dict[str, Scenario] = {
    "steady 20": Scenario(duration_s=310.0, schedule=steps("0:20mbit")),
    "steady 5": Scenario(duration_s=310.0, schedule=steps("0:5mbit")),
    "fall 20 to 5": Scenario(duration_s=45.0, schedule=steps("0:20mbit,20:5mbit"), falls=(20.0,)),
    "fall 5 to 1": Scenario(duration_s=45.0, schedule=steps("0:5mbit,20:1mbit"), falls=(20.0,)),
    "rise 5 to 20": Scenario(duration_s=50.0, schedule=steps("0:5mbit,20:20mbit"), rises=(20.0,)),
    "fall 20 to 5, unseen": Scenario(
        duration_s=45.0, schedule=steps("0:20mbit,20:5mbit"), model=UNSEEN_QUEUE, falls=(20.0,)
    ),
    "fall 5 to 1, unseen": Scenario(
        duration_s=45.0, schedule=steps("0:5mbit,20:1mbit"), model=UNSEEN_QUEUE, falls=(20.0,)
    ),
    "ramp": Scenario(duration_s=100.0, schedule=ramp),
    "noisy": Scenario(duration_s=130.0, schedule=noisy),
    "bursts, all lost": Scenario(
        duration_s=100.0,
        schedule=steps("0:20mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, bursts=GilbertElliott(good_s=3.0, bad_s=0.3)),
    ),
    "bursts, half lost": Scenario(
        duration_s=100.0,
        schedule=steps("0:20mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, bursts=GilbertElliott(good_s=3.0, bad_s=0.3, bad_loss=0.5)),
    ),
    "outages, lost": Scenario(
        duration_s=85.0,
        schedule=steps("0:20mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, outages=_OUTAGES),
        outages=_OUTAGES,
    ),
    "outages, stalled": Scenario(duration_s=85.0, schedule=stalling(_OUTAGES), outages=_OUTAGES),
    **{
        f"oscillation {period_s:g} s": Scenario(duration_s=duration_s, schedule=oscillation(period_s, duration_s))
        for period_s, duration_s in ((2.0, 80.0), (5.0, 80.0), (10.0, 80.0), (30.0, 140.0))
    },
    "contention, same host": Scenario(
        duration_s=60.0,
        schedule=steps("0:20mbit"),
        foreign=(ForeignFlow(start_s=20.0, end_s=40.0, rate_bytes_per_second=8.0 * MBIT),),
    ),
    "contention, air": Scenario(duration_s=60.0, schedule=busy_air),
    "small messages": Scenario(
        duration_s=50.0,
        schedule=steps("0:5mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, packet_overhead_s=200e-6),
        robot=SMALL_ROBOT,
    ),
    "small, aggregated": Scenario(
        duration_s=50.0,
        schedule=steps("0:5mbit"),
        model=LinkModel(queue_bytes=QUEUE_BYTES, packet_overhead_s=200e-6, aggregate_packets=16),
        robot=SMALL_ROBOT,
    ),
    "app-limited": Scenario(duration_s=70.0, schedule=steps("0:20mbit"), robot=LIGHT_ROBOT),
}
