"""The share problem in the units in which ADMM converges: measured from the floors, in parts of what is left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from arpd.solvers.outcome import ShareProblem

#: κ above the highest level ν a constraint admits, by this factor: with an optimum at rest on no constraint, OSQP 1.1
#: skips polishing and writes "Polishing not needed" to stdout even when it is not verbose.
_KAPPA_MARGIN = 1.1


@dataclass(frozen=True, kw_only=True, slots=True)
class ScaledProblem:
    """``min |z|²/2 + q·z  s.t.  d·z ≤ b, 0 ≤ z ≤ h``, where e = lo + unit·d·z.

    The unit is what can be handed out above the floors: B − Σ lo, or Σ (hi − lo) where that is less (then b > 1 and
    every topic gets all it wants).

    With d_i = √w_i (divided by the middle of the weights), |z|²/2 is Σ (e_i − lo_i)²/(2w_i): every topic has the same
    curvature however light or small it is, and nothing is left for the solver's own scaling to do. Of 500 random
    problems with weights over two decades, OSQP failed on or missed 42 as written, and on none of them in this form.

    Parameters
    ----------
    root : d
    slope : q
    ceiling : h
    limit : b ≥ 1
    floor, unit : lo and the unit, to come back from z
    """

    root: NDArray[np.float64]
    slope: NDArray[np.float64]
    ceiling: NDArray[np.float64]
    limit: float
    floor: NDArray[np.float64]
    unit: float

    def shares(self, point: NDArray[np.float64]) -> list[float]:
        """Return the shares e of a point z."""
        return [float(share) for share in self.floor + self.unit * self.root * point]


def root_weights(weights: tuple[int, ...]) -> NDArray[np.float64]:
    """Return d, √w over the geometric middle of the lightest and the heaviest: it depends on the weights alone."""
    middle = math.sqrt(min(weights)) * math.sqrt(max(weights))
    return np.array([math.sqrt(weight / middle) for weight in weights])


def scaled(problem: ShareProblem) -> ScaledProblem | None:
    """Scale ``problem``; None when nothing is left to hand out, for then the floors are the only answer."""
    floors, ceilings = sum(problem.lo), sum(problem.hi)
    unit = min(problem.budget, ceilings) - floors
    if unit <= 0:
        return None
    limit = (problem.budget - floors) / unit
    root = root_weights(problem.weights)
    floor = np.array([low / problem.whole for low in problem.lo])
    ceiling = np.array([min((high - low) / unit, limit) for low, high in zip(problem.lo, problem.hi, strict=True)])
    levels = (floor + unit / problem.whole * ceiling) / root**2
    kappa = _KAPPA_MARGIN * float(np.min(levels[ceiling >= limit], initial=np.max(levels)))
    # a topic whose floor is above κ·w stays there whatever its slope; at its true slope it would only slow ADMM down
    slope = np.minimum(floor / root**2 - kappa, 0.0) * root / (unit / problem.whole)
    return ScaledProblem(
        root=root, slope=slope, ceiling=ceiling / root, limit=limit, floor=floor, unit=unit / problem.whole
    )
