"""The links of `adapt.py`: two stay as they are; each of the others is steady for five seconds, then changes."""

from __future__ import annotations

import random
from bisect import bisect_right
from dataclasses import dataclass

from arpd.adapters.sim.loss import LossStep
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.trace import read_trace
from scripts.bench.adapt_walk import DURATION_S, TRACE

MBIT = 125_000.0  # bytes/s
CALM_S = 5.0
OUTAGE_BYTES_PER_SECOND = 10.0  # loss alone is no outage: a lost packet has crossed the link
_GOOD_S, _BAD_S = 3.0, 0.3  # mean times of the burst-loss link (Gilbert 1960, Elliott 1963)
_BAD_LOSSES = (0.5, 1.0)
SEED = 6  # its bursts take 9 % of the time, as those of the chain do in the long run, and are of both kinds


@dataclass(frozen=True, kw_only=True, slots=True)
class Link:
    """The course of one link.

    Parameters
    ----------
    name : its name in tables and for ``--only``
    what : its course in words
    losses : probability of loss over time, by ascending start; none before the first
    duration_s : time that the sources publish (s)
    sides : sides that are measured over it; none = all
    """

    name: str
    what: str
    rates: RateSchedule
    losses: tuple[LossStep, ...] = ()
    duration_s: float = DURATION_S
    sides: tuple[str, ...] = ()

    def loss_at(self, elapsed_s: float) -> float:
        """Return the probability that a packet is lost at this time (0..1)."""
        begun = bisect_right(self.losses, elapsed_s, key=lambda step: step.start_s)
        return self.losses[begun - 1].loss if begun else 0.0

    @property
    def changes_s(self) -> tuple[float, ...]:
        """Times at which the rate changes (s)."""
        return tuple(step.start_s for step in self.rates.steps[1:])

    @property
    def outages(self) -> tuple[tuple[float, float], ...]:
        """Spans in which nothing passes (s, s)."""
        ends_s = (*self.changes_s, self.duration_s)
        return tuple(
            (step.start_s, end_s)
            for step, end_s in zip(self.rates.steps, ends_s, strict=True)
            if step.rate_bytes_per_second <= OUTAGE_BYTES_PER_SECOND
        )

    @property
    def mean_bytes_per_second(self) -> float:
        """Mean rate over the run (bytes/s)."""
        ends_s = (*self.changes_s, self.duration_s)
        spans = zip(self.rates.steps, ends_s, strict=True)
        return sum(step.rate_bytes_per_second * (end_s - step.start_s) for step, end_s in spans) / self.duration_s


def links(seed: int) -> tuple[Link, ...]:
    """Return every link; the seed sets the times of the bursts."""
    trace = read_trace(TRACE)
    outage = ((0.0, 20 * MBIT), (8.0, OUTAGE_BYTES_PER_SECOND), (13.0, 20 * MBIT))
    return (
        Link(name="step-down", what="20 → 5 Mbit/s", rates=_rates((0.0, 20 * MBIT), (CALM_S, 5 * MBIT))),
        Link(name="step-up", what="5 → 20 Mbit/s", rates=_rates((0.0, 5 * MBIT), (CALM_S, 20 * MBIT))),
        Link(name="ramp", what="20 → 3 → 20 Mbit/s, each over 10 s", rates=_ramp()),
        Link(
            name="burst-loss",
            what="20 Mbit/s; for 0.3 s every 3 s, both at random, half or all packets are lost",
            rates=_rates((0.0, 20 * MBIT)),
            losses=tuple(_bursts(random.Random(seed))),
        ),
        Link(
            name="outage",
            what="20 Mbit/s; nothing passes for 5 s",
            rates=_rates(*outage),
            losses=(LossStep(start_s=8.0, loss=1.0), LossStep(start_s=13.0, loss=0.0)),
        ),
        Link(
            name="oscillation",
            what="20 ↔ 5 Mbit/s every 4 s",
            rates=_rates((0.0, 20 * MBIT), *((CALM_S + 4.0 * k, (20 * MBIT, 5 * MBIT)[(k + 1) % 2]) for k in range(6))),
        ),
        Link(
            name="wifi-walk",
            what="1.5 to 20 Mbit/s, as a walk away from the access point and back gives it",
            rates=trace.rates,
            losses=trace.losses,
        ),
        *(
            Link(
                name=f"steady-{mbit}",
                what=f"{mbit} Mbit/s",
                rates=_rates((0.0, mbit * MBIT)),
                duration_s=40.0,
                sides=("arpd", "oracle"),
            )
            for mbit in (20, 5)
        ),
    )


def quick_link() -> Link:
    """Return the short step down of ``--quick``."""
    return Link(name="step-down", what="20 → 5 Mbit/s", rates=_rates((0.0, 20 * MBIT), (2.0, 5 * MBIT)), duration_s=6.0)


def _rates(*steps: tuple[float, float]) -> RateSchedule:
    return RateSchedule(steps=tuple(RateStep(start_s=at_s, rate_bytes_per_second=rate) for at_s, rate in steps))


def _ramp() -> RateSchedule:
    """Fall from 20 to 3 Mbit/s by equal ratios in steps of 0.5 s, rest, and rise again."""
    steps = [(0.0, 20 * MBIT)]
    ratio = (3 / 20) ** (1 / 20)
    steps += [(CALM_S + 0.5 * k, 20 * MBIT * ratio ** (k + 1)) for k in range(20)]
    steps += [(CALM_S + 13.0 + 0.5 * k, 3 * MBIT / ratio ** (k + 1)) for k in range(20)]
    return _rates(*(step for step in steps if step[0] < DURATION_S))


def _bursts(rng: random.Random) -> list[LossStep]:
    """Return random bursts of loss; the last ends before the run does, so that samples under way can arrive."""
    steps: list[LossStep] = []
    now_s = CALM_S
    while True:
        end_s = now_s + rng.expovariate(1.0 / _BAD_S)
        if end_s >= DURATION_S - 1.0:
            return steps
        steps += [LossStep(start_s=now_s, loss=rng.choice(_BAD_LOSSES)), LossStep(start_s=end_s, loss=0.0)]
        now_s = end_s + rng.expovariate(1.0 / _GOOD_S)
