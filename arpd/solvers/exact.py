"""Water-filling: the closed form of the share problem, and the judge of every other back end."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING

from arpd.settings import Backend
from arpd.solvers.outcome import Outcome, ShareProblem, Solved, infeasibility, settle

if TYPE_CHECKING:
    from collections.abc import Sequence


class ExactSolver:
    """Solves the share problem by its breakpoints in O(n log n).

    f(ν) = Σ clip(ν·w_i, lo_i, hi_i) is continuous, nondecreasing and linear between the sorted values lo_i/w_i and
    hi_i/w_i. Bisect them for the piece that holds B, then solve that piece for ν.

    Every sum is ``math.fsum``, correctly rounded and thus independent of order, and the topics of a piece are a set:
    permuting the topics permutes the answer, bit for bit.
    """

    name = Backend.EXACT

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem``; never ``SolverFailed``."""
        return infeasibility(problem) or Solved(values=settle(problem, water_fill(problem)))


def water_fill(problem: ShareProblem) -> tuple[float, ...]:
    """Return e_i = clip(ν·w_i, lo_i, hi_i) with the largest ν that keeps Σ e_i ≤ B; lo if even lo exceeds B."""
    weights, lo, hi = problem.weights, problem.lo, problem.hi
    if math.fsum(hi) <= problem.budget:
        return hi
    starts = [low / weight for low, weight in zip(lo, weights, strict=True)]
    stops = [high / weight for high, weight in zip(hi, weights, strict=True)]
    points = sorted({*starts, *stops})
    piece = bisect_right(points, problem.budget, key=lambda level: math.fsum(_at(level, problem))) - 1
    if piece < 0:
        return lo
    if piece == len(points) - 1:  # the last breakpoint fits after all: rounding of level·w_i below hi_i
        return hi
    low, high = points[piece], points[piece + 1]
    free = [start <= low and stop >= high for start, stop in zip(starts, stops, strict=True)]
    fixed = math.fsum(0.0 if is_free else (hi[i] if stops[i] <= low else lo[i]) for i, is_free in enumerate(free))
    slope = math.fsum(weight for weight, is_free in zip(weights, free, strict=True) if is_free)
    level = (problem.budget - fixed) / slope if slope > 0.0 else low
    return tuple(
        _clip(level * weights[i], lo[i], hi[i]) if is_free else (hi[i] if stops[i] <= low else lo[i])
        for i, is_free in enumerate(free)
    )


def _at(level: float, problem: ShareProblem) -> Sequence[float]:
    return [
        _clip(level * weight, lo, hi) for weight, lo, hi in zip(problem.weights, problem.lo, problem.hi, strict=True)
    ]


def _clip(value: float, lo: float, hi: float) -> float:
    return min(max(value, lo), hi)
