"""Water-filling in whole numbers: the exact answer to the share problem, and the judge of every other back end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from arpd.model.settings import Backend
from arpd.solve.problem import Outcome, Solved, infeasibility

if TYPE_CHECKING:
    from arpd.solve.problem import ShareProblem


class ActiveBound(Enum):
    """Bound at which a share is, or the common level."""

    LOW = "at its floor"
    LEVEL = "at the common level"
    HIGH = "at its ceiling"


@dataclass(frozen=True, kw_only=True, slots=True)
class WaterFill:
    """Exact solution of a share problem: e_i = lo_i, ν·w_i or hi_i, as ``bounds`` says.

    Parameters
    ----------
    problem : the problem it solves
    level : ν = level[0]/level[1], the common level (1/whole per weight)
    bounds : bound of each share, or the common level
    """

    problem: ShareProblem
    level: tuple[int, int]
    bounds: tuple[ActiveBound, ...]

    @property
    def level_per_weight(self) -> float:
        """ν as a share of the whole, per unit of the weights; ``inf`` when every share has all it asks for.

        A ceiling of the whole is no wish of its own, so ν stays finite there.
        """
        p = self.problem
        if any(bound is ActiveBound.LEVEL for bound in self.bounds):
            return self.level[0] / (self.level[1] * p.whole)
        reached = [(hi, w) for hi, w, at in zip(p.hi, p.weights, self.bounds, strict=True) if at is ActiveBound.HIGH]
        if len(reached) == len(p.hi) and p.whole not in p.hi:
            return math.inf
        return max((hi / (w * p.whole) for hi, w in reached), default=0.0)

    def ratios(self) -> list[tuple[int, int]]:
        """Return every share exactly, as numerator and denominator (1/whole)."""
        p, (numerator, denominator) = self.problem, self.level
        return [
            (numerator * weight, denominator)
            if bound is ActiveBound.LEVEL
            else (low if bound is ActiveBound.LOW else high, 1)
            for weight, low, high, bound in zip(p.weights, p.lo, p.hi, self.bounds, strict=True)
        ]

    def shares(self) -> tuple[float, ...]:
        """Return every share as a float (dimensionless)."""
        p, level = self.problem, self.level[0] / (self.level[1] * self.problem.whole)
        return tuple(
            [
                level * weight if bound is ActiveBound.LEVEL else (low if bound is ActiveBound.LOW else high) / p.whole
                for weight, low, high, bound in zip(p.weights, p.lo, p.hi, self.bounds, strict=True)
            ]
        )


class ExactSolver:
    """Closed form as a back end; it never returns ``SolverFailed``."""

    name = Backend.EXACT

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem``."""
        return infeasibility(problem) or Solved(values=water_fill(problem).shares())


def water_fill(problem: ShareProblem) -> WaterFill:
    """Return e_i = clip(ν·w_i, lo_i, hi_i) with the largest ν that keeps Σ e_i ≤ B.

    Variable fixing (Bitran & Hax 1981; Kiwiel 2008): pour what is left evenly over the undecided shares. If the
    ceilings cut off more than the floors add, the level will only rise, so every share at its ceiling stays there. If
    they cut off less, the level will only fall, so every share at its floor stays there. If both are equal, this is the
    solution. Every round decides at least one share, and about six rounds decide thousands. All comparisons and sums
    use whole numbers, so there is no tolerance, and the order of the topics does not matter.

    Parameters
    ----------
    problem : a feasible one, Σ lo_i ≤ B
    """
    weights, lo, hi = problem.weights, problem.lo, problem.hi
    bounds = [ActiveBound.LEVEL] * len(weights)
    undecided, left, weight = list(range(len(weights))), problem.budget, sum(weights)
    while undecided:  # invariant: left and weight belong to the undecided, weight > 0
        above, below, between = [], [], []
        surplus = 0  # of the ceilings over the floors (1/whole·weight)
        for i in undecided:
            poured = left * weights[i]
            if (cut := poured - hi[i] * weight) >= 0:
                surplus += cut
                above.append(i)
            elif (added := lo[i] * weight - poured) >= 0:
                surplus -= added
                below.append(i)
            else:
                between.append(i)
        if surplus >= 0:
            for i in above:
                bounds[i] = ActiveBound.HIGH
                left -= hi[i]
                weight -= weights[i]
        if surplus <= 0:
            for i in below:
                bounds[i] = ActiveBound.LOW
                left -= lo[i]
                weight -= weights[i]
        if surplus == 0:
            break
        undecided = between + (below if surplus > 0 else above)
    return WaterFill(problem=problem, level=(left, max(1, weight)), bounds=tuple(bounds))
