"""OSQP, called directly (Stellato et al., OSQP, Math. Prog. Comp. 2020).

The trailing underscore keeps ``import osqp`` here from meaning this module.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import osqp
from scipy.sparse import csc_matrix

if TYPE_CHECKING:
    from arpd.solve.eq4 import Eq4Problem
    from arpd.solve.level import Column

#: ρ adapts at a fixed interval of iterations, and the algebra is OSQP's own, so that a problem takes the same course on
#: every machine.
_OPTIONS: dict[str, Any] = {
    "adaptive_rho_interval": 25,
    "check_dualgap": False,
    "eps_abs": 1e-9,
    "eps_rel": 0.0,
    "polishing": True,
    "rho": 10.0,
    "scaling": 0,
    "verbose": False,
}


def level(weights: Column, low: Column, high: Column, budget: float) -> float:
    """Return ν = −y of  min Σ e²/(2w)  s.t.  Σ e = B (: y),  low ≤ e ≤ high.

    It solves for x = e·√N/B: all rows then have length 1. A ceiling that no share can reach costs digits, so ceilings
    are cut a little above what is left after the floors.
    """
    count, unit = len(weights), budget / math.sqrt(len(weights))
    mean = 1.0 / float((1.0 / weights).mean())
    reachable = np.minimum(high, low + 1.125 * (budget - low.sum()))
    each = np.arange(count)
    rows = np.column_stack((np.zeros(count, dtype=int), each + 1)).ravel()  # the link, and the bounds of each share
    workspace = osqp.OSQP(algebra="builtin")
    workspace.setup(
        P=csc_matrix((mean / weights, each, np.arange(count + 1))),
        q=np.zeros(count),
        A=csc_matrix((np.tile((count**-0.5, 1.0), count), rows, np.arange(0, 2 * count + 1, 2))),
        l=np.concatenate(([1.0], low / unit)),
        u=np.concatenate(([1.0], reachable / unit)),
        **_OPTIONS,
    )
    return -float(workspace.solve(raise_error=False).y[0]) * budget / (count * mean)


def eq4(problem: Eq4Problem) -> tuple[float, float]:
    """Return (R, D) of Eq. (4), in the shares e = R/Rmax and g = D/Dmax.

    OSQP needs curvature. (2) bounds R alone, and (3) lets D grow with R, so every objective that rises in both has the
    same optimum: here (e² + g²)/2 − (e + g) is the least, for e, g ≤ 1.
    """
    rate_floor, depth_floor = problem.min_rate_hz / problem.max_rate_hz, problem.min_depth / problem.max_depth
    workspace = osqp.OSQP(algebra="builtin")
    workspace.setup(
        P=csc_matrix(np.eye(2)),
        q=-np.ones(2),
        A=csc_matrix([[1.0, 0.0], [-1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]),
        l=np.array([-np.inf, -np.inf, rate_floor, depth_floor]),
        u=np.array([1.0 / problem.topics - rate_floor, -depth_floor, 1.0, 1.0]),
        **_OPTIONS,
    )
    rate_share, depth_share = workspace.solve(raise_error=False).x
    return float(rate_share) * problem.max_rate_hz, float(depth_share) * problem.max_depth
