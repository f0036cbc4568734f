"""Eq. (4) as Jalil & Kobayashi publish it, one DEADLINE rate R and one DEPTH D for all topics, and on the live link.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from arpd.model.allocation import Binding, Uniform
from arpd.model.plan import NANOSECONDS_PER_SECOND, TopicPlan, rate_of
from arpd.solve.level import TOLERANCE, Yielding, left, water_level
from arpd.solve.link import NO_CAPACITY, Division, Find, Link, Rows

if TYPE_CHECKING:
    from arpd.model.price import Price

# DDS counts whole seconds in 32 bits (DDS 1.4 §2.3.2, Duration_t); a slower topic counts as paused.
LONGEST_PERIOD_NS = (2**31 - 1) * NANOSECONDS_PER_SECOND
_NOISE = 1e-12  # of a float
# Terms of every row of a uniform plan. Equal terms give every publisher the same rate. They never change, so the price
# alone moves the rate, also when a topic comes or a message grows, and no plan is needed for that.
_WEIGHT, _WIRE_BYTES, _PACKETS = 1.0, 1000.0, 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Eq4Problem:
    """max R + D  s.t.  Rmax/N − R ≥ Rmin (2),  Dmax·R/Rmax − D ≥ Dmin (3),  bounds on R and D  (4).

    Parameters
    ----------
    max_rate_hz : Rmax, the highest rate when only one topic is used (Hz)
    topics : N, sensing and actuation topics together
    min_rate_hz : Rmin (Hz)
    min_depth, max_depth : Dmin and Dmax (samples)
    """

    max_rate_hz: float
    topics: int
    min_rate_hz: float = 1.0
    min_depth: int = 1
    max_depth: int = 5000

    def __post_init__(self) -> None:
        for name, value in (("max_rate_hz", self.max_rate_hz), ("min_rate_hz", self.min_rate_hz)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} {value!r} must be a positive number (Hz)")
        if self.topics < 1:
            raise ValueError(f"topics {self.topics} must be at least 1")
        if not 1 <= self.min_depth <= self.max_depth:
            raise ValueError(f"depths {self.min_depth}..{self.max_depth} must be a range that starts at 1 or above")

    def depth_limit(self, rate_hz: float) -> float:
        """Return the largest D that (3) and Dmax allow at a rate; below Dmin where none is feasible (samples)."""
        return min(self.max_depth, self.max_depth * rate_hz / self.max_rate_hz - self.min_depth)

    def vertex(self) -> tuple[float, float]:
        """Return the optimum (R*, D*), if any: (2) bounds R alone, and D may only grow with R, so both are tight."""
        rate_hz = self.max_rate_hz / self.topics - self.min_rate_hz
        return rate_hz, self.depth_limit(rate_hz)

    def applied(self, rate_hz: float) -> tuple[int, int]:
        """Return the whole period of a rate (ns), and the depth that keeps (3) at the rate of that period (samples)."""
        period = period_ns(rate_hz)
        return period, max(self.min_depth, whole(self.depth_limit(rate_of(period))))

    def refusal(self) -> str:
        """Name the constraint that cannot be met, in words; empty when the vertex meets all, and so is the optimum."""
        rate_hz, depth = self.vertex()
        if rate_hz < self.min_rate_hz * (1.0 - _NOISE):
            return (
                f"(2) leaves Rmax/N − Rmin = {rate_hz:g} Hz, below Rmin = {self.min_rate_hz:g} Hz; "
                "use fewer topics or a lower Rmin"
            )
        if depth < self.min_depth * (1.0 - _NOISE):
            return (
                f"(3) leaves Dmax·R/Rmax − Dmin = {depth:g} at R = {rate_hz:g} Hz, below Dmin = "
                f"{self.min_depth}; raise Dmax or lower Dmin"
            )
        return ""


class AlikeOnLink(Link):
    """Eq. (4) of the topics on a link (`policy: uniform`), with Rmax for one of mean cost on the divided part of it.

    N counts every topic that crosses the link. Where (2) cannot be met, the rate reserve gives way, then Rmin, by no
    more than they must. So R never rises while the capacity falls, and N topics at R always fit. A source that is
    slower than R keeps its own period; what it leaves goes to nobody, as in the paper.

    Parameters
    ----------
    crossing : topics that cross the link, managed or not
    """

    def __init__(self, rows: Rows, capacity: float, packet_overhead_s: float, share: float, *, crossing: int) -> None:
        super().__init__(rows, capacity, packet_overhead_s, share)
        self._topics = max(crossing, len(rows.topics))
        self._max_rate_hz = self.budget / float(self.costs_s.mean())
        self._even_hz, self._floor_hz = self._max_rate_hz / self._topics, float(rows.floors_hz.max())
        self._rate_hz = min(self._even_hz, max(self._floor_hz, self._even_hz - self._floor_hz))
        self.floors_hz = np.full_like(self.costs_s, self._floor_hz)

    def price(self, find: Find = water_level) -> Price:  # noqa: ARG002 - the optimum is a vertex
        """Return the price at which every row of a uniform plan has the rate R."""
        kept = min(1.0, self._rate_hz / self._floor_hz) if self._floor_hz else float(self.budget > 0.0)
        level = self._rate_hz * _WIRE_BYTES / (_WEIGHT * (self.capacity or 1.0))
        price = self.priced(level, Yielding(_WEIGHT if kept < 1.0 else 0.0, kept))
        return replace(price, packet_overhead_s=0.0)

    def _large_level(self) -> float:
        return 0.0  # no topic has a rate of its own

    def divide(self, memory_bytes: float, find: Find) -> Division:
        """Return R for all but slower sources, and D = clip(τ·R − Dmin, Dmin, Dmax) or what memory holds."""
        rows, rate_hz = self.rows, self._rate_hz
        least, most = float(rows.min_depths.max()), float(rows.max_depths.max())
        of_link_s, latency_s = most / (self._max_rate_hz or math.inf), float(rows.latencies_s.min())
        justified = min(of_link_s, latency_s) * rate_hz - least
        depth, binding = least, Binding.MINIMUM
        if justified >= least:
            depth, binding = justified, Binding.LATENCY_BUDGET if latency_s < of_link_s else Binding.LINK
        held = memory_bytes / max(1.0, float(rows.slots.sum()))
        if held < depth:
            depth, binding = max(1.0, held), Binding.MEMORY
        return Division(
            price=self.price(find),
            rates_hz=np.minimum(rate_hz, self.ceilings_hz),
            depths=np.full_like(self.costs_s, depth),
            depth_bindings=[binding] * len(rows.topics),
            given_up=self._given_up(holds=held / least),
            uniform=Uniform(topics=self._topics, max_rate_hz=self._max_rate_hz, rate_hz=rate_hz, depth=whole(depth)),
        )

    def _given_up(self, *, holds: float) -> list[str]:
        kept = self._even_hz / self._floor_hz if self._floor_hz else math.inf
        reserve = max(0.0, kept - 1.0)
        words = [f"rate reserve {left(reserve)}"] if reserve < 1.0 - TOLERANCE else []
        words += [f"minimum rate {left(kept)}"] if kept < 1.0 - TOLERANCE else []
        depth = ["memory budget below the minimum depth"] if holds < 1.0 - TOLERANCE else []
        return (words if self.budget else [NO_CAPACITY]) + depth


def alike(row: TopicPlan) -> TopicPlan:
    """Return a row of a uniform plan: its terms are those of every other row, so the price gives all one rate."""
    return replace(row, weight=_WEIGHT, wire_bytes=_WIRE_BYTES, packets=_PACKETS)


def period_ns(rate_hz: float) -> int:
    """Return the shortest whole period that is not faster than the rate: ⌈1e9/R⌉ (ns); 0 for a paused topic.

    Rounding the period up can only lower the rate, and every constraint on the link, Eq. (2) as well as (G1), loosens
    as R falls, so a feasible rate stays feasible. A period above the longest DDS duration is a pause, too.
    """
    if rate_hz <= NANOSECONDS_PER_SECOND / (LONGEST_PERIOD_NS + 1):
        return 0
    return math.ceil(NANOSECONDS_PER_SECOND / rate_hz * (1.0 - _NOISE))


def whole(amount: float) -> int:
    """Return an amount rounded down; one that misses a whole number by a solver's tolerance is that number."""
    return math.floor(amount * (1.0 + TOLERANCE))
