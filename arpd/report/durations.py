"""Durations of the daemon: its ticks, their lateness, and its solves."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True, kw_only=True, slots=True)
class Distribution:
    """Counts of durations between bounds; a value, so that a snapshot that holds one never changes.

    Parameters
    ----------
    bounds : upper bounds, ascending, each part of the interval below it (s)
    counts : durations up to each bound and above the one before; last, those above all bounds
    total_s : sum of all durations (s)
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


# A tick has 0.1 s, and one that begins 0.05 s late counts as late: both are bounds.
_TICK = Distribution.over(0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
# A dozen topics take a millisecond, a thousand some ten (scripts/bench/solve.py).
_SOLVE = Distribution.over(0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25)


@dataclass(frozen=True, kw_only=True, slots=True)
class Durations:
    """Durations since the daemon started.

    Parameters
    ----------
    ticks : ticks that finished
    lateness : of begins of ticks; 0 for one that a report called early
    solves : solves of the program; a tick with nothing new solves nothing
    """

    ticks: Distribution = _TICK
    lateness: Distribution = _TICK
    solves: Distribution = _SOLVE

    def with_ticks(
        self,
        ticks_s: Iterable[float],
        *,
        late_s: Iterable[float],
        solve_s: float | None,
    ) -> Durations:
        """Return these and those of some more ticks.

        Parameters
        ----------
        ticks_s, late_s : durations of the ticks, and how late they began (s)
        solve_s : duration of their solve (s); None = they needed none
        """
        return replace(
            self,
            ticks=self.ticks.including(ticks_s),
            lateness=self.lateness.including(late_s),
            solves=self.solves if solve_s is None else self.solves.including((solve_s,)),
        )
