"""Durations of the daemon: its ticks, their lateness, and its solves."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

# A tick has 0.1 s, and one that begins 0.05 s late counts as late: both are bounds.
_TICK = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
# A dozen topics take a millisecond, a thousand some ten (scripts/bench/solve.py).
_SOLVE = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25)


@dataclass(frozen=True, slots=True)
class Distribution:
    """Counts of durations between bounds; a value, so that a snapshot that holds one never changes.

    Parameters
    ----------
    bounds : upper bounds, ascending, each part of the interval below it (s)
    counts : durations up to each bound and above the one before; last, those above all bounds; empty = none
    total_s : sum of all durations (s)
    """

    bounds: tuple[float, ...]
    counts: tuple[int, ...] = ()
    total_s: float = 0.0

    def including(self, durations_s: Iterable[float]) -> Distribution:
        """Return one that counts these, too (s)."""
        counts, total_s = list(self.counts) or [0] * (len(self.bounds) + 1), self.total_s
        for duration_s in durations_s:
            counts[bisect_left(self.bounds, duration_s)] += 1
            total_s += duration_s
        return Distribution(self.bounds, tuple(counts), total_s)

    @property
    def up_to(self) -> tuple[tuple[float, int], ...]:
        """Each bound with the number of durations up to it (s); the last bound is infinite and counts them all."""
        return tuple(zip((*self.bounds, float("inf")), accumulate(self.including(()).counts), strict=True))


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations of finished ticks, delays with which ticks began, and durations of solves, since the start."""

    ticks: Distribution = Distribution(_TICK)
    lateness: Distribution = Distribution(_TICK)
    solves: Distribution = Distribution(_SOLVE)

    def including(self, ticks_s: Iterable[float], late_s: Iterable[float], solves_s: Iterable[float]) -> Durations:
        """Return these and some more (s)."""
        ticks, lateness = self.ticks.including(ticks_s), self.lateness.including(late_s)
        return Durations(ticks, lateness, self.solves.including(solves_s))
