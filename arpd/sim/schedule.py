"""Rate and loss of a simulated link over time, in steps, and what it can have carried by a moment."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.quantities import parse_rate

if TYPE_CHECKING:
    from typing import Self


@dataclass(frozen=True, kw_only=True, slots=True)
class RateStep:
    """A link rate from a moment on.

    Parameters
    ----------
    start_s : time since the start of the run, >= 0 (s)
    rate_bytes_per_second : link rate, >= 0; 0 = the link carries nothing (bytes/s)
    """

    start_s: float
    rate_bytes_per_second: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0):
            raise ValueError(f"step at {self.start_s} s: the time must be zero or later")
        if not (math.isfinite(self.rate_bytes_per_second) and self.rate_bytes_per_second >= 0.0):
            raise ValueError(f"step at {self.start_s:g} s: the rate must be zero or more")


class LossStep(NamedTuple):
    """A probability of loss, 0..1, from a moment of run time on (s)."""

    start_s: float
    loss: float


@dataclass(frozen=True, kw_only=True, slots=True)
class RateSchedule:
    """Rate of a link over the time of a run.

    Parameters
    ----------
    steps : steps by ascending start, the first at 0; the last one holds without end
    """

    steps: tuple[RateStep, ...]

    def __post_init__(self) -> None:
        if not self.steps or self.steps[0].start_s != 0.0:
            raise ValueError("the first step must start at 0, for example '0:20mbit,20:5mbit'")
        for earlier, later in pairwise(self.steps):
            if later.start_s == earlier.start_s:
                raise ValueError(f"two steps start at {later.start_s:g} s; keep one")
            if later.start_s < earlier.start_s:
                raise ValueError(f"the step at {later.start_s:g} s comes after the one at {earlier.start_s:g} s")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``SECONDS:RATE`` pairs separated by commas, in any order: ``0:20mbit,20:5mbit,50:20mbit``.

        A rate of zero is an error, because the text also shapes the real link, whose token bucket needs a rate.

        Raises
        ------
        ValueError
            If the text is not a schedule; the message names the step and the way out.
        """
        steps = [_parse_step(part.strip()) for part in text.split(",")]
        return cls(steps=tuple(sorted(steps, key=lambda step: step.start_s)))

    @property
    def duration_s(self) -> float:
        """Start of the last step (s)."""
        return self.steps[-1].start_s

    def rate_at(self, t_s: float) -> float:
        """Return the rate ``t_s`` seconds after the start of the run (bytes/s)."""
        if not t_s >= 0.0:
            raise ValueError(f"time {t_s} s is before the start of the run")
        return self.steps[bisect_right(self.steps, t_s, key=lambda step: step.start_s) - 1].rate_bytes_per_second


def _parse_step(text: str) -> RateStep:
    start, colon, rate = text.partition(":")
    if not colon:
        raise ValueError(f"step {text!r}: write SECONDS:RATE, for example 20:5mbit")
    try:
        start_s = float(start)
    except ValueError:
        raise ValueError(f"step {text!r}: {start!r} is not a number of seconds") from None
    try:
        rate_bytes_per_second = parse_rate(rate)
    except ValueError as error:
        raise ValueError(f"step {text!r}: {error}") from error
    if not rate_bytes_per_second > 0.0:
        raise ValueError(f"step {text!r}: the rate must be above zero; use loss 1 for an outage")
    return RateStep(start_s=start_s, rate_bytes_per_second=rate_bytes_per_second)


class Service:
    """The integral of a schedule over time and its inverse, so that packets need no events.

    The current step is cached, because most questions are about the same step as the last one.

    Parameters
    ----------
    schedule : rate over run time
    origin_s : start of run time; before it, the first rate holds (s)
    """

    def __init__(self, schedule: RateSchedule, origin_s: float) -> None:
        self._starts = [origin_s + step.start_s for step in schedule.steps]
        self._rates = [step.rate_bytes_per_second for step in schedule.steps]
        spans = [end - start for start, end in pairwise(self._starts)]
        self._bytes = [0.0, *accumulate(s * r for s, r in zip(spans, self._rates, strict=False))]
        self._take(0)

    def by(self, t_s: float) -> float:
        """Return the bytes that the link can have carried from the origin to this moment."""
        if not self._from_s <= t_s < self._until_s:
            self._take(max(0, bisect_right(self._starts, t_s) - 1))
        return self._base + (t_s - self._start_s) * self._rate

    def when(self, size: float) -> float:
        """Return the first moment by which the link can have carried so many bytes, ``inf`` = never (s)."""
        if not (self._least < size <= self._most and self._rate > 0.0):
            self._take(max(0, bisect_left(self._bytes, size) - 1))
            if self._rate == 0.0:  # no further byte after the last step; all earlier ones at its start
                return math.inf if size > self._base else self._start_s
        return self._start_s + (size - self._base) / self._rate

    def _take(self, i: int) -> None:
        self._start_s, self._rate, self._base = self._starts[i], self._rates[i], self._bytes[i]
        is_first, is_last = i == 0, i + 1 == len(self._starts)
        self._from_s = -math.inf if is_first else self._start_s
        self._until_s = math.inf if is_last else self._starts[i + 1]
        self._least = -math.inf if is_first else self._base
        self._most = math.inf if is_last else self._bytes[i + 1]
