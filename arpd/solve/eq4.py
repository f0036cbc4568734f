"""Eq. (4) as Jalil & Kobayashi publish it: one DEADLINE rate and one DEPTH for all topics.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING

from arpd.model.settings import Backend
from arpd.solve.problem import TOLERANCE, Outcome, Solved, SolverFailed
from arpd.solve.rows import period_ns, rate_of, rational

if TYPE_CHECKING:
    from collections.abc import Sequence


class Eq4Status(StrEnum):
    """Existence of a solution of Eq. (4)."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"


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
        if not (math.isfinite(self.max_rate_hz) and self.max_rate_hz > 0):
            raise ValueError(f"max_rate_hz {self.max_rate_hz!r} must be a positive number (Hz)")
        if not (math.isfinite(self.min_rate_hz) and self.min_rate_hz > 0):
            raise ValueError(f"min_rate_hz {self.min_rate_hz!r} must be a positive number (Hz)")
        if self.topics < 1:
            raise ValueError(f"topics {self.topics} must be at least 1")
        if not 1 <= self.min_depth <= self.max_depth:
            raise ValueError(f"depths {self.min_depth}..{self.max_depth} must be a range that starts at 1 or above")

    def depth_limit(self, rate_hz: Fraction) -> Fraction:
        """Return the largest D that (3) and Dmax allow at a rate; below Dmin where none is feasible (samples)."""
        limit = self.max_depth * rate_hz / rational(self.max_rate_hz) - self.min_depth
        return min(Fraction(self.max_depth), limit)

    def vertex(self) -> tuple[Fraction, Fraction]:
        """Return the optimum (R*, D*), if any: (2) bounds R alone, and D may only grow with R, so both are tight."""
        rate = rational(self.max_rate_hz) / self.topics - rational(self.min_rate_hz)
        return rate, self.depth_limit(rate)

    def checked(self, point: Sequence[float], *, solver: str) -> Outcome:
        """Return the outcome of a library's (R, D): ``Solved`` only if every constraint holds to ``TOLERANCE``."""
        rate, depth = point[0] / self.max_rate_hz, point[1] / self.max_depth
        rate_floor, depth_floor = self.min_rate_hz / self.max_rate_hz, self.min_depth / self.max_depth
        slacks = (
            1.0 / self.topics - rate_floor - rate,
            rate - depth_floor - depth,
            rate - rate_floor,
            1.0 - rate,
            depth - depth_floor,
            1.0 - depth,
        )
        if not all(slack >= -TOLERANCE for slack in slacks):  # also catches nan
            return SolverFailed(reason=f"{solver}: constraints are violated by {-min(slacks):.3g}")
        return Solved(values=(point[0], point[1]))


@dataclass(frozen=True, kw_only=True, slots=True)
class Eq4Solution:
    """Answer to Eq. (4); every number is 0 when it is infeasible.

    Parameters
    ----------
    status : existence of an optimum
    rate_hz, depth : the real optimum R*, D*, of the exact vertex (Hz, samples)
    rate_hz_floor, depth_floor : ⌊R*⌋ and ⌊D*⌋, the paper's Table 2
    deadline_ns : ⌈1e9 / R*⌉ (ns)
    depth_applied : depth that keeps (3) at the rate of that whole period (samples)
    binding : the constraints that hold with equality, or the one that cannot be met and why
    backend : back end that found it
    agreed : True when the requested back end agreed with the exact vertex; otherwise ``backend`` is ``exact``
    """

    status: Eq4Status
    rate_hz: float = 0.0
    depth: float = 0.0
    rate_hz_floor: int = 0
    depth_floor: int = 0
    deadline_ns: int = 0
    depth_applied: int = 0
    binding: str = ""
    backend: Backend = Backend.EXACT
    agreed: bool = True


def solve_eq4(problem: Eq4Problem, backend: Backend = Backend.EXACT) -> Eq4Solution:
    """Solve Eq. (4) with ``backend``; the exact vertex decides feasibility, checks the answer, and is what is returned.

    Feasibility is analytic: R* is the largest rate that (2) allows, and (3) allows the largest depth there, so Eq. (4)
    has a solution if and only if this one point satisfies the lower bounds.

    The applied depth is ⌊D⌋ at the rate of the whole period, so (3) holds by construction. Where (3) leaves exactly
    Dmin at R*, no whole period satisfies it; the depth then stays Dmin, off by less than 1e-6 samples.
    """
    rate, depth = problem.vertex()
    if refusal := _refusal(problem, rate, depth):
        return Eq4Solution(status=Eq4Status.INFEASIBLE, binding=refusal)
    used = backend if _agrees(problem, backend, vertex=(rate, depth)) else Backend.EXACT
    period = period_ns(rate.as_integer_ratio())
    return Eq4Solution(
        status=Eq4Status.OPTIMAL,
        rate_hz=float(rate),
        depth=float(depth),
        rate_hz_floor=math.floor(rate),
        depth_floor=math.floor(depth),
        deadline_ns=period,
        depth_applied=max(problem.min_depth, math.floor(problem.depth_limit(Fraction(*rate_of(period))))),
        binding="(2) link share, (3) depth share",
        backend=used,
        agreed=used is backend,
    )


def _refusal(problem: Eq4Problem, rate: Fraction, depth: Fraction) -> str:
    """Name the constraint that cannot be met, in words; empty when all can."""
    if rate < rational(problem.min_rate_hz):
        return (
            f"(2) leaves Rmax/N − Rmin = {float(rate):g} Hz, below Rmin = {problem.min_rate_hz:g} Hz; "
            "use fewer topics or a lower Rmin"
        )
    if depth < problem.min_depth:
        return (
            f"(3) leaves Dmax·R/Rmax − Dmin = {float(depth):g} at R = {float(rate):g} Hz, below Dmin = "
            f"{problem.min_depth}; raise Dmax or lower Dmin"
        )
    return ""


def _agrees(problem: Eq4Problem, backend: Backend, *, vertex: tuple[Fraction, Fraction]) -> bool:
    """Return whether the back end solves the problem, and finds the exact vertex."""
    if backend is Backend.EXACT:
        return True
    outcome: Outcome = import_module(f"arpd.solve.{backend}_").solve_eq4(problem)
    scales = problem.max_rate_hz, problem.max_depth
    return isinstance(outcome, Solved) and all(
        abs(found - float(exact)) <= TOLERANCE * scale
        for found, exact, scale in zip(outcome.values, vertex, scales, strict=True)
    )
