"""OSQP, called directly on the share-scaled program (Stellato et al., OSQP, Math. Prog. Comp. 2020).

The trailing underscore keeps ``import osqp`` here from meaning this module.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import osqp
from scipy import sparse

from arpd.settings import Backend
from arpd.solvers.outcome import Outcome, ShareProblem, SolverFailed, checked, infeasibility
from arpd.solvers.scaling import scaled

if TYPE_CHECKING:
    from arpd.paper import Eq4Problem

#: ρ is fixed: adapting it costs factorisations and depends on timing. Polishing solves the active set exactly, so
#: a polished answer is good to 1e-12 although ADMM itself stops at 1e-6. Starting cold makes the answer a function
#: of the problem alone, not of the problems before it: a warm start saves microseconds and costs repeatability.
#: With weights over six decades about one problem in eight still ends at ``max_iter``; ``exact`` answers those.
OPTIONS: dict[str, float | int | bool] = {
    "rho": 1.0,
    "adaptive_rho": False,
    "eps_abs": 1e-6,
    "eps_rel": 0.0,
    "check_termination": 5,
    "polishing": True,
    "scaling": 0,
    "warm_starting": False,
    "max_iter": 4000,
    "verbose": False,
}

#: Eq. (4) is set up anew each time, so ρ may adapt; at a fixed interval of iterations that is repeatable. Of 500 random
#: feasible problems 23 end at ``max_iter`` with ρ fixed, and none with it.
OPTIONS_EQ4 = OPTIONS | {"adaptive_rho": True, "adaptive_rho_interval": 25}


class OsqpSolver:
    """Keeps one factorisation for as long as the weights stay, and updates only q, l and u.

    P and A depend on nothing but the weights, and the solver's own scaling, which would depend on the first problem it
    saw, is off. (G1) and (G2) have the same weights, so one workspace serves both.
    """

    name = Backend.OSQP

    def __init__(self) -> None:
        self._weights: tuple[int, ...] = ()
        self._workspace: Any = None

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem`` and re-check the residuals of the answer."""
        if verdict := infeasibility(problem):
            return verdict
        units = scaled(problem)
        if units is None:
            return checked(problem, [low / problem.whole for low in problem.lo], solver="osqp")
        bounds = {
            "l": np.concatenate(([-np.inf], np.zeros_like(units.ceiling))),
            "u": np.concatenate(([units.limit], units.ceiling)),
        }
        try:
            if problem.weights == self._weights:
                self._workspace.update(q=units.slope, **bounds)
            else:
                self._weights = ()  # a setup that raises must not leave another problem's workspace in use
                self._workspace = osqp.OSQP()
                identity = sparse.identity(len(units.root), format="csc")
                rows = sparse.vstack([units.root.reshape(1, -1), identity], format="csc")
                self._workspace.setup(P=identity, q=units.slope, A=rows, **bounds, **OPTIONS)
                self._weights = problem.weights
            result = self._workspace.solve(raise_error=False)
        except (osqp.OSQPException, ValueError) as error:
            self._weights = ()
            return SolverFailed(reason=f"osqp: {type(error).__name__}: {error}")
        if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            return SolverFailed(reason=f"osqp: {result.info.status} after {result.info.iter} iterations")
        return checked(problem, units.shares(result.x), solver="osqp")


def solve_eq4(problem: Eq4Problem) -> Outcome:
    """Solve Eq. (4) in the shares e = R/Rmax and g = D/Dmax; return (R, D).

    The LP as printed makes OSQP fail (its columns differ by Dmax/Rmax and it has no curvature). The vertex of
    Eq. (4) is greater in both coordinates than any other feasible point: (2) bounds R alone and (3) lets D grow with
    R. So every objective that increases in both picks it, and this one is strictly convex:
    min (e² + g²)/2 − (e + g), rising for e, g < 1.
    """
    rate_floor = problem.min_rate_hz / problem.max_rate_hz
    depth_floor = problem.min_depth / problem.max_depth
    rows = sparse.csc_matrix([[1.0, 0.0], [-1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    workspace = osqp.OSQP()
    try:
        workspace.setup(
            P=sparse.identity(2, format="csc"),
            q=-np.ones(2),
            A=rows,
            l=np.array([-np.inf, -np.inf, rate_floor, depth_floor]),
            u=np.array([1.0 / problem.topics - rate_floor, -depth_floor, 1.0, 1.0]),
            **OPTIONS_EQ4,
        )
        result = workspace.solve(raise_error=False)
    except (osqp.OSQPException, ValueError) as error:
        return SolverFailed(reason=f"osqp: {type(error).__name__}: {error}")
    if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
        return SolverFailed(reason=f"osqp: {result.info.status}")
    rate_share, depth_share = (float(value) for value in result.x)
    return problem.checked((rate_share * problem.max_rate_hz, depth_share * problem.max_depth), solver="osqp")
