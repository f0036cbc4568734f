"""How long something takes, every time it is done: what a histogram is made of."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True, kw_only=True, slots=True)
class Distribution:
    """Counts of durations between bounds; a value, so that a snapshot that holds one never changes.

    Parameters
    ----------
    bounds : upper bounds, ascending, each belonging to what is below it (s)
    counts : durations up to each bound and above the one before; the last count is of those above all bounds
    total_s : what all durations add up to (s)
    """

    bounds: tuple[float, ...]
    counts: tuple[int, ...]
    total_s: float = 0.0

    @classmethod
    def over(cls, *bounds: float) -> Distribution:
        """Return an empty one with the given upper bounds (s)."""
        if not bounds or list(bounds) != sorted(set(bounds)):
            raise ValueError(f"bounds {bounds} do not ascend")
        return cls(bounds=bounds, counts=(0,) * (len(bounds) + 1))

    def including(self, durations_s: Iterable[float]) -> Distribution:
        """Return one that counts these, too (s)."""
        counts, total_s = list(self.counts), self.total_s
        for duration_s in durations_s:
            counts[bisect_left(self.bounds, duration_s)] += 1
            total_s += duration_s
        return Distribution(bounds=self.bounds, counts=tuple(counts), total_s=total_s)

    @property
    def up_to(self) -> tuple[tuple[float, int], ...]:
        """Each bound with the number of durations up to it (s); the last bound is infinite and counts them all."""
        return tuple(zip((*self.bounds, float("inf")), accumulate(self.counts), strict=True))
