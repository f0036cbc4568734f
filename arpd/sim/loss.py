"""Loss on a simulated link: at random, by a schedule, in bursts and in outages."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from random import Random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class LossStep:
    """A probability of loss from a moment on.

    Parameters
    ----------
    start_s : time since the start of the run, >= 0 (s)
    loss : probability that a packet is lost, 0..1
    """

    start_s: float
    loss: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0):
            raise ValueError(f"loss step at {self.start_s} s: the time must be zero or later")
        check_probability(f"loss step at {self.start_s:g} s", self.loss)


@dataclass(frozen=True, kw_only=True, slots=True)
class GilbertElliott:
    """Loss in bursts: the link is good or bad for exponentially distributed times.

    This is the chain of Gilbert (1960) and Elliott (1963) in continuous time; the state also changes while nothing is
    sent. The link starts good and is bad for ``bad_s / (good_s + bad_s)`` of the time in the long run.

    Parameters
    ----------
    good_s, bad_s : mean duration of a good and of a bad state, > 0 (s)
    bad_loss : probability that a packet is lost in the bad state, 0..1; none is in the good one
    """

    good_s: float
    bad_s: float
    bad_loss: float = 1.0

    def __post_init__(self) -> None:
        for name, duration_s in (("good_s", self.good_s), ("bad_s", self.bad_s)):
            if not (math.isfinite(duration_s) and duration_s > 0.0):
                raise ValueError(f"{name} {duration_s}: a mean duration must be above zero (s)")
        check_probability("bad_loss", self.bad_loss)

    @property
    def mean_loss(self) -> float:
        """Share of packets that are lost in the long run."""
        return self.bad_s * self.bad_loss / (self.good_s + self.bad_s)


def check_probability(name: str, value: float) -> None:
    """Raise ValueError if the value is not from 0 to 1."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name}: {value} is not a probability, from 0 to 1")


def check_ascending(losses: Sequence[LossStep]) -> None:
    """Raise ValueError if a step does not start after the one before it."""
    for earlier, later in pairwise(losses):
        if not later.start_s > earlier.start_s:
            raise ValueError(f"the loss step at {later.start_s:g} s comes after the one at {earlier.start_s:g} s")


def loss_at(steps: Sequence[LossStep], run_s: float) -> float:
    """Return the probability of loss in force, 0 before the first step."""
    return next((step.loss for step in reversed(steps) if step.start_s <= run_s), 0.0)


class Losses:
    """Decides how many packets survive; call it in order of time.

    Parameters
    ----------
    loss : probability that a packet is lost at any time, 0..1
    steps : further loss over time, none before the first step
    bursts : further loss in bursts
    outages : spans in which nothing arrives (s, s)
    origin_s : zero of all times above (s)
    random : source of the losses

    Attributes
    ----------
    is_lossless : True if every packet survives at any time
    """

    def __init__(
        self,
        *,
        loss: float,
        steps: Sequence[LossStep],
        bursts: GilbertElliott | None,
        outages: Sequence[tuple[float, float]],
        origin_s: float,
        random: Random,
    ) -> None:
        self._loss = loss
        self._random = random
        self._starts = [origin_s + step.start_s for step in steps]
        self._steps = [step.loss for step in steps]
        self._outages = [(origin_s + start_s, origin_s + end_s) for start_s, end_s in outages]
        # Bursts have their own source, so that the traffic does not change when they come.
        self._bursts: _Bursts | None = None
        if bursts is not None:
            own = Random(random.getrandbits(64))  # noqa: S311 - a repeatable run, not a secret
            self._bursts = _Bursts(bursts, origin_s, own)
        self.is_lossless = not (loss or self._steps or self._outages or bursts)

    def survivors(self, packets: int, at_s: float) -> int:
        """Return how many of the packets that are due at this moment arrive."""
        if self.is_lossless or at_s == math.inf:  # packets that are never due are not lost
            return packets
        if any(start_s <= at_s < end_s for start_s, end_s in self._outages):
            return 0
        loss = self._loss
        if self._starts and (i := bisect_right(self._starts, at_s)):
            loss = either(loss, self._steps[i - 1])
        if self._bursts is not None:
            loss = either(loss, self._bursts.loss_at(at_s))
        if not loss:
            return packets
        draw = self._random.random
        return int(draw() >= loss) if packets == 1 else sum([draw() >= loss for _ in range(packets)])


class _Bursts:
    """State of a Gilbert-Elliott link, drawn up to the latest question; good until the run starts."""

    def __init__(self, model: GilbertElliott, origin_s: float, random: Random) -> None:
        self._model = model
        self._random = random
        self._is_bad = False
        self._until_s = origin_s + random.expovariate(1.0 / model.good_s)

    def loss_at(self, at_s: float) -> float:
        model = self._model
        while self._until_s <= at_s:
            self._is_bad = not self._is_bad
            self._until_s += self._random.expovariate(1.0 / (model.bad_s if self._is_bad else model.good_s))
        return model.bad_loss if self._is_bad else 0.0


def either(one: float, other: float) -> float:
    """Return the probability that at least one of two independent losses happens."""
    return 1.0 - (1.0 - one) * (1.0 - other)
