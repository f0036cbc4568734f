"""Rate and loss of a simulated link over time, in steps, and what it can have carried by a moment."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple, Self

from arpd.model.quantities import RATE


class RateStep(NamedTuple):
    """A link rate from a moment of run time on; 0 = the link carries nothing (s, bytes/s)."""

    start_s: float
    rate_bytes_per_second: float


class LossStep(NamedTuple):
    """A probability of loss, 0..1, from a moment of run time on (s)."""

    start_s: float
    loss: float


def outages(*spans_s: tuple[float, float]) -> tuple[LossStep, ...]:
    """Return the loss over run time of a link on which nothing arrives in some spans (s)."""
    return tuple(step for start_s, end_s in spans_s for step in (LossStep(start_s, 1.0), LossStep(end_s, 0.0)))


@dataclass(frozen=True, kw_only=True, slots=True)
class RateSchedule:
    """Rate of a link over the time of a run.

    Parameters
    ----------
    steps : steps by ascending start, the first at 0
    period_s : when they begin again, after the last of them; infinite = that one holds without end (s)
    """

    steps: tuple[RateStep, ...]
    period_s: float = math.inf

    def __post_init__(self) -> None:
        if not self.steps or self.steps[0].start_s != 0.0:
            raise ValueError("the first step must start at 0, for example '0:20mbit,20:5mbit'")
        for earlier, later in pairwise(self.steps):
            if not earlier.start_s < later.start_s:
                raise ValueError(f"two steps start at {later.start_s:g} s; keep one")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``SECONDS:RATE`` pairs separated by commas, in any order: ``0:20mbit,20:5mbit,50:20mbit``.

        A rate of zero is an error, because the text also shapes the real link, whose token bucket needs a rate.

        Raises
        ------
        ValueError
            If the text is not a schedule; the message names the step and the way out.
        """
        return cls(steps=tuple(sorted(_parse_step(part.strip()) for part in text.split(","))))

    @property
    def duration_s(self) -> float:
        """Start of the last step (s)."""
        return self.steps[-1].start_s

    def rate_at(self, t_s: float) -> float:
        """Return the rate at a moment of run time, 0 or later (bytes/s)."""
        now_s = t_s % self.period_s
        return self.steps[bisect_right(self.steps, now_s, key=lambda step: step.start_s) - 1].rate_bytes_per_second


def _parse_step(text: str) -> RateStep:
    start, colon, rate = text.partition(":")
    if not colon:
        raise ValueError(f"step {text!r}: write SECONDS:RATE, for example 20:5mbit")
    try:
        start_s = float(start)
    except ValueError:
        raise ValueError(f"step {text!r}: {start!r} is not a number of seconds") from None
    if not 0.0 <= start_s < math.inf:
        raise ValueError(f"step {text!r}: the time must be zero or later")
    try:
        rate_bytes_per_second = RATE.parse(rate)
    except ValueError as error:
        raise ValueError(f"step {text!r}: {error}") from error
    if not rate_bytes_per_second > 0.0:
        raise ValueError(f"step {text!r}: the rate must be above zero; use loss 1 for an outage")
    return RateStep(start_s, rate_bytes_per_second)


class Service:
    """The integral of a schedule over run time and its inverse; before the run, the first rate holds."""

    def __init__(self, schedule: RateSchedule) -> None:
        self._starts = [step.start_s for step in schedule.steps]
        self._rates = [step.rate_bytes_per_second for step in schedule.steps]
        spans = (end - start for start, end in pairwise(self._starts))
        self._bytes = [0.0, *accumulate(s * r for s, r in zip(spans, self._rates, strict=False))]
        self._period_s = self._period_bytes = math.inf
        if math.isfinite(schedule.period_s):
            self._period_bytes, self._period_s = self.by(schedule.period_s), schedule.period_s

    def by(self, t_s: float) -> float:
        """Return the bytes that the link can have carried from the start of the run to this moment."""
        if t_s >= self._period_s:
            turns, t_s = divmod(t_s, self._period_s)
            return turns * self._period_bytes + self.by(t_s)
        i = max(0, bisect_right(self._starts, t_s) - 1)
        return self._bytes[i] + (t_s - self._starts[i]) * self._rates[i]

    def when(self, size: float) -> float:
        """Return the first moment by which the link can have carried so many bytes, ``inf`` = never (s)."""
        if size > self._period_bytes:
            turns = math.ceil(size / self._period_bytes) - 1  # whole ones before the byte asked for
            return turns * self._period_s + self.when(size - turns * self._period_bytes)
        i = max(0, bisect_left(self._bytes, size) - 1)
        base, start_s, rate = self._bytes[i], self._starts[i], self._rates[i]
        if not rate:  # no further byte after the last step; all earlier ones at its start
            return math.inf if size > base else start_s
        return start_s + (size - base) / rate
