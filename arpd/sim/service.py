"""Bytes that a link can have carried by a moment, and the moment by which it can have carried them."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.sim.schedule import RateSchedule


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

    def rate_at(self, t_s: float) -> float:
        """Return the rate at a moment (bytes/s)."""
        self.by(t_s)
        return self._rate

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
