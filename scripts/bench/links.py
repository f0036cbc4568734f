"""The courses of the links: rate and loss over time."""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.sim.schedule import RateSchedule, RateStep, Service
from arpd.sim.trace import read_trace
from scripts.netns.simlink import STALLED

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

MBIT = 125_000.0  # bytes/s
WALK = Path(__file__).with_name("wifi_walk.csv")  # from path loss, shadowing and fades, with the MCS of 802.11n
DURATION_S, CALM_S, STALL_S, CELLULAR_S = 28.0, 5.0, 50.0, 120.0
_OUT = 10.0  # bytes/s: loss alone is no outage, because a lost packet has crossed the link
GOOD_S, _BAD_S = 3.0, 0.3  # mean times of the burst-loss link (Gilbert 1960, Elliott 1963)
SEED = 6  # its bursts take 9 % of the time, as those of the chain do in the long run
#: Both directions from each time on: begin (s), rate (bytes/s), loss (0..1); the first begins at 0.
Course = list[tuple[float, float, float]]


def at(course: Course, now_s: float) -> tuple[float, float]:
    """Return rate (bytes/s) and loss (0..1) of a time (s)."""
    return course[max(0, bisect_right(course, now_s, key=lambda step: step[0]) - 1)][1:]


def links(seed: int = SEED) -> dict[str, tuple[str, Course]]:
    """Return what each link does, and its course."""
    fast, slow, least = 20 * MBIT, 5 * MBIT, 3 * MBIT
    ratio = (least / fast) ** (1 / 20)
    falling = [(CALM_S + 0.5 * k, fast * ratio ** (k + 1), 0.0) for k in range(20)]
    rising = [(CALM_S + 13.0 + 0.5 * k, least / ratio ** (k + 1), 0.0) for k in range(20)]
    swings = [(CALM_S + 4.0 * k, (fast, slow)[(k + 1) % 2], 0.0) for k in range(6)]
    trace = read_trace(WALK)
    starts_s = sorted({step.start_s for step in trace.rates.steps} | {step.start_s for step in trace.losses})
    losses = [(step.start_s, 0.0, step.loss) for step in trace.losses] or [(0.0, 0.0, 0.0)]
    return {
        "step-down": ("20 → 5 Mbit/s", [(0.0, fast, 0.0), (CALM_S, slow, 0.0)]),
        "step-up": ("5 → 20 Mbit/s", [(0.0, slow, 0.0), (CALM_S, fast, 0.0)]),
        "ramp": ("20 → 3 → 20 Mbit/s, each over 10 s", [(0.0, fast, 0.0), *falling, *rising]),
        "burst-loss": ("20 Mbit/s; for 0.3 s every 3 s, at random, half or all packets are lost", _bursts(seed)),
        "outage": ("20 Mbit/s; nothing passes for 5 s", [(0.0, fast, 0.0), (8.0, _OUT, 1.0), (13.0, fast, 0.0)]),
        "oscillation": ("20 ↔ 5 Mbit/s every 4 s", [(0.0, fast, 0.0), *swings]),
        "wifi-walk": (
            "1.5 to 20 Mbit/s, as a walk away from the access point and back gives it",
            [(start_s, trace.rates.rate_at(start_s), at(losses, start_s)[1]) for start_s in starts_s],
        ),
        "cellular": ("0 to 12 Mbit/s, as Sprout models a cellular link", _every(cellular(seed), 0.1)),
        "steady-20": ("20 Mbit/s", [(0.0, fast, 0.0)]),
        "steady-5": ("5 Mbit/s", [(0.0, slow, 0.0)]),
        "fall-and-rise": ("20 → 5 → 20 Mbit/s", [(0.0, fast, 0.0), (CALM_S, slow, 0.0), (CALM_S + 9.0, fast, 0.0)]),
        "stalled": (
            "20 Mbit/s; for 50 s everything waits",
            [(0.0, fast, 0.0), (CALM_S, STALLED, 0.0), (CALM_S + STALL_S, fast, 0.0)],
        ),
        "loss-2": ("20 Mbit/s, 2 % of the packets are lost", [(0.0, fast, 0.02)]),
        "loss-5": ("20 Mbit/s, 5 % of the packets are lost", [(0.0, fast, 0.05)]),
    }


def marks(course: Iterable[tuple[float, float]]) -> RateSchedule:
    """Return a schedule with another rate (Mbit/s) from each time on (s)."""
    return RateSchedule(steps=tuple(RateStep(at_s, mbit * MBIT) for at_s, mbit in course))


def cellular(seed: int) -> RateSchedule:
    """Return a link as Sprout models it (Winstein, Sivaraman, Balakrishnan, NSDI 2013, §3), over two minutes.

    Packets leave by a Poisson process whose rate is a Brownian motion, reflected at 0 and at 12 Mbit/s; near 0 begins
    an outage, which ends at a rate of its own. Deviation and rate of escape are the paper's.
    """
    rng, step_s, most = random.Random(f"cellular up {seed}"), 0.02, 1000.0
    rate, found = rng.uniform(0.0, most), list[tuple[float, float]]()
    for k in range(round(CELLULAR_S / step_s) + 1):
        if rate > 0.0 or rng.random() < -math.expm1(-step_s):
            rate = abs(rate + rng.gauss(0.0, 200.0 * math.sqrt(step_s)))
            rate = min(rate, 2.0 * most - rate)
            rate = rate if rate >= most / 256 else 0.0
        packets, waited = 0, rng.expovariate(1.0)
        while waited < rate * step_s:
            packets, waited = packets + 1, waited + rng.expovariate(1.0)
        found.append((round(k * step_s, 9), packets * 1500 * 8e-6 / step_s))
    return marks([*found, (CELLULAR_S + 1.0, 12.0)])  # what waits at the end must leave


def _every(schedule: RateSchedule, step_s: float) -> Course:
    """Return the mean rates of spans of this length; where nothing passes, everything waits."""
    service, starts_s = Service(schedule), [step_s * k for k in range(round(DURATION_S / step_s))]
    spans = ((start_s, (service.by(start_s + step_s) - service.by(start_s)) / step_s) for start_s in starts_s)
    return [(start_s, max(STALLED, rate), 0.0) for start_s, rate in spans]


def bursts(rng: random.Random, begin_s: float) -> Iterator[tuple[float, float]]:
    """Yield begin and end of bursts of 0.3 s in the mean, 3 s apart in the mean, without end (s)."""
    while True:
        end_s = begin_s + rng.expovariate(1.0 / _BAD_S)
        yield begin_s, end_s
        begin_s = end_s + rng.expovariate(1.0 / GOOD_S)


def _bursts(seed: int) -> Course:
    """Return random bursts of loss; the last ends before the run does, so that samples under way can arrive."""
    rng, fast = random.Random(seed), 20 * MBIT
    course = [(0.0, fast, 0.0)]
    for begin_s, end_s in takewhile(lambda burst: burst[1] < DURATION_S - 1.0, bursts(rng, CALM_S)):
        course += [(begin_s, fast, rng.choice((0.5, 1.0))), (end_s, fast, 0.0)]
    return course
