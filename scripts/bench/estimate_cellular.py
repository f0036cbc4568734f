"""A link as a cellular network gives it, after Sprout (Winstein, Sivaraman, Balakrishnan, NSDI 2013, §3).

Packets leave by a Poisson process whose rate is a Brownian motion. The motion is reflected at 0 and at the largest
rate. Where it comes as near to 0 as the lowest of the 256 bins of their program, an outage begins, which ends at a rate
of its own. Deviation and rate of escape are the paper's. Over 120 s and 20 seeds, such links carried 3.3 to 8.3 Mbit/s
on average (all: 5.5), and nothing in 14 % of the tenths of a second.
"""

from __future__ import annotations

import math
from random import Random

from arpd.adapters.sim.schedule import RateSchedule, RateStep

STEP_S = 0.02
_PACKET_BYTES = 1500
_MOTION = 200.0  # deviation of the rate after a second (packets/s)
_MOST = 1000.0  # largest rate, 12 Mbit/s (packets/s)
_OUTAGE = _MOST / 256  # (packets/s)
_ESCAPES_PER_S = 1.0


def cellular(seed: str, duration_s: float) -> RateSchedule:
    """Return one direction of a link; after ``duration_s`` it holds its last rate, or the largest after an outage."""
    random = Random(f"cellular {seed}")
    rate = random.uniform(0.0, _MOST)
    steps: list[RateStep] = []
    for k in range(round(duration_s / STEP_S) + 1):
        if rate > 0.0 or random.random() < -math.expm1(-_ESCAPES_PER_S * STEP_S):
            rate = abs(rate + random.gauss(0.0, _MOTION * math.sqrt(STEP_S)))
            rate = min(rate, 2.0 * _MOST - rate)
            rate = rate if rate >= _OUTAGE else 0.0
        carried = _packets(random, rate * STEP_S) * _PACKET_BYTES / STEP_S
        if not steps or carried != steps[-1].rate_bytes_per_second:
            steps.append(RateStep(start_s=round(k * STEP_S, 9), rate_bytes_per_second=carried))
    if steps[-1].rate_bytes_per_second == 0.0:  # what waits at the end of a run must leave
        steps.append(RateStep(start_s=duration_s + STEP_S, rate_bytes_per_second=_MOST * _PACKET_BYTES))
    return RateSchedule(steps=tuple(steps))


def _packets(random: Random, mean: float) -> int:
    """Draw from the Poisson distribution."""
    count, waited = 0, random.expovariate(1.0)
    while waited < mean:
        count += 1
        waited += random.expovariate(1.0)
    return count
