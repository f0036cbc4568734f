"""Eq. (4) as Jalil & Kobayashi publish it: one DEADLINE rate R and one DEPTH D for all topics.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from arpd.model.plan import NANOSECONDS_PER_SECOND
from arpd.solve.level import TOLERANCE

# DDS counts whole seconds in 32 bits (DDS 1.4 §2.3.2, Duration_t); a slower topic counts as paused.
_LONGEST_PERIOD_NS = (2**31 - 1) * NANOSECONDS_PER_SECOND
_NOISE = 1e-12  # of a float


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
        """Refuse nonsense at birth."""
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


def period_ns(rate_hz: float) -> int:
    """Return the shortest whole period that is not faster than the rate: ⌈1e9/R⌉ (ns); 0 for a paused topic.

    Rounding the period up can only lower the rate, and every constraint on the link, Eq. (2) as well as (G1), loosens
    as R falls, so a feasible rate stays feasible. A period above the longest DDS duration is a pause, too.
    """
    if rate_hz <= NANOSECONDS_PER_SECOND / (_LONGEST_PERIOD_NS + 1):
        return 0
    return math.ceil(NANOSECONDS_PER_SECOND / rate_hz * (1.0 - _NOISE))


def rate_of(period: int) -> float:
    """Return the rate of a whole period in ns (Hz); 0 for a paused topic."""
    return NANOSECONDS_PER_SECOND / period if period else 0.0


def whole(amount: float) -> int:
    """Return an amount rounded down; one that misses a whole number by a solver's tolerance is that number."""
    return math.floor(amount * (1.0 + TOLERANCE))
