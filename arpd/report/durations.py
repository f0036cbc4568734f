"""Durations of the daemon: its ticks, their lateness, its solves, and the phases of its publishers' swaps."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from itertools import accumulate
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.endpoints import PublisherState, SwapPhase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


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
# The timeouts of `arpd.endpoint.writer_swap.SwapTiming` lie between bounds, never on one: 0.3, 3, 4 and 10 s.
_PHASE = Distribution.over(0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 2.9, 3.5, 4.5, 7.5, 9.5, 15.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Durations:
    """Durations since the daemon started.

    Parameters
    ----------
    ticks : ticks that finished
    lateness : of begins of ticks; 0 for one that a report called early
    solves : solves of the program; a tick with nothing new solves nothing
    swap_phases : phases of QoS swaps that finished, by `arpd.model.endpoints.SwapPhase`
    """

    ticks: Distribution = _TICK
    lateness: Distribution = _TICK
    solves: Distribution = _SOLVE
    swap_phases: Mapping[str, Distribution] = field(
        default_factory=lambda: MappingProxyType(dict.fromkeys(SwapPhase, _PHASE))
    )

    def with_ticks(
        self,
        ticks_s: Iterable[float],
        *,
        late_s: Iterable[float],
        solve_s: float | None,
        phases: Mapping[str, list[float]],
    ) -> Durations:
        """Return these and those of some more ticks.

        Parameters
        ----------
        ticks_s, late_s : durations of the ticks, and how late they began (s)
        solve_s : duration of their solve (s); None = they needed none
        phases : time that swaps which finished meanwhile spent in each phase (s)
        """
        swap_phases = self.swap_phases
        if phases:
            more = {phase: swap_phases.get(phase, _PHASE).including(each) for phase, each in phases.items()}
            swap_phases = MappingProxyType({**swap_phases, **more})
        return replace(
            self,
            ticks=self.ticks.including(ticks_s),
            lateness=self.lateness.including(late_s),
            solves=self.solves if solve_s is None else self.solves.including((solve_s,)),
            swap_phases=swap_phases,
        )


class SwapWatch:
    """Finds the swaps that finished since the last look, each once.

    A publisher that is new, or back, announces a swap that finished at an unknown time, maybe before this daemon
    started; it does not count. A number or a time that is lower than before means that the publisher restarted. The
    record of a swap is made before the old writer has drained, so the time of draining is the growth of its total.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[str, str], tuple[int, float]] = {}  # by topic and node: swap's number, time draining (s)

    def look(self, publishers: Iterable[PublisherState]) -> dict[str, list[float]]:
        """Return the time that the swaps which finished spent in each phase they entered (s)."""
        before, self._last = self._last, {}
        found: dict[str, list[float]] = {}
        for publisher in publishers:
            identity, swap = (publisher.topic, publisher.node), publisher.last_swap
            number = 0 if swap is None else swap.number
            drained_s = publisher.swap_seconds_by_phase.get(SwapPhase.DRAINING, 0.0)
            self._last[identity] = number, drained_s
            number_before, drained_before_s = before.get(identity, (number, drained_s))
            times = {} if swap is None or number == number_before else dict(swap.seconds_by_phase)
            grown_s = drained_s - drained_before_s
            times[SwapPhase.DRAINING] = drained_s if grown_s < 0 else grown_s
            for phase, duration_s in times.items():
                if duration_s > 0:
                    found.setdefault(phase, []).append(duration_s)
        return found
