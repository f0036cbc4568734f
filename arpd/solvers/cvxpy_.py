"""cvxpy: the readable statement of the mathematics, for teaching and cross-checks rather than for the tick.

Import this module only when cvxpy is asked for: it costs about 2 s and 113 MiB.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cvxpy as cp

from arpd.settings import Backend
from arpd.solvers.outcome import Outcome, ShareProblem, SolverFailed, checked, infeasibility
from arpd.solvers.scaling import root_weights, scaled

if TYPE_CHECKING:
    from arpd.paper import Eq4Problem

#: An interior-point method, so that this back end shares no algorithm with the other two. Its defaults stop at 1e-8 of
#: the objective, which leaves a small topic several percent off; through OSQP, cvxpy splits the bounds into two rows
#: each and 8 of 100 random problems do not converge.
OPTIONS: dict[str, Any] = {"solver": cp.CLARABEL, "tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}


class CvxpySolver:
    """A parametrised (DPP) problem per set of weights; slope, ceilings and limit are its Parameters."""

    name = Backend.CVXPY

    def __init__(self) -> None:
        self._weights: tuple[int, ...] = ()
        self._problem: Any = None

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem`` and re-check the residuals of the answer."""
        if verdict := infeasibility(problem):
            return verdict
        units = scaled(problem)
        if units is None:
            return checked(problem, [low / problem.whole for low in problem.lo], solver="cvxpy")
        if problem.weights != self._weights:
            self._problem = _state(problem.weights)
            self._weights = problem.weights
        self._problem.param_dict["slope"].value = units.slope
        self._problem.param_dict["ceiling"].value = units.ceiling
        self._problem.param_dict["limit"].value = units.limit
        try:
            self._problem.solve(**OPTIONS)
        except (cp.error.SolverError, ValueError) as error:
            return SolverFailed(reason=f"cvxpy: {type(error).__name__}: {error}")
        if self._problem.status != cp.OPTIMAL:  # .value is filled even then
            return SolverFailed(reason=f"cvxpy: {self._problem.status}")
        return checked(problem, units.shares(self._problem.var_dict["z"].value), solver="cvxpy")


def solve_eq4(problem: Eq4Problem) -> Outcome:
    """Solve Eq. (4) literally, as the linear program the paper prints; return (R, D).

    An interior-point solver (Clarabel) copes with the scaling that OSQP does not.
    """
    rate, depth = cp.Variable(name="R"), cp.Variable(name="D")
    statement = cp.Problem(
        cp.Maximize(rate + depth),
        [
            problem.max_rate_hz / problem.topics - rate >= problem.min_rate_hz,  # (2)
            problem.max_depth * rate / problem.max_rate_hz - depth >= problem.min_depth,  # (3)
            rate >= problem.min_rate_hz,
            rate <= problem.max_rate_hz,
            depth >= problem.min_depth,
            depth <= problem.max_depth,
        ],
    )
    try:
        statement.solve(solver=cp.CLARABEL)
    except (cp.error.SolverError, ValueError) as error:
        return SolverFailed(reason=f"cvxpy: {type(error).__name__}: {error}")
    if statement.status != cp.OPTIMAL:
        return SolverFailed(reason=f"cvxpy: {statement.status}")
    return problem.checked((float(rate.value), float(depth.value)), solver="cvxpy")


def _state(weights: tuple[int, ...]) -> Any:
    """State the scaled share problem of ``ScaledProblem`` for one set of weights."""
    root = root_weights(weights)
    z = cp.Variable(len(weights), name="z")
    slope = cp.Parameter(len(weights), name="slope")
    ceiling = cp.Parameter(len(weights), name="ceiling", nonneg=True)
    limit = cp.Parameter(name="limit", nonneg=True)
    return cp.Problem(cp.Minimize(cp.sum_squares(z) / 2 + slope @ z), [root @ z <= limit, z >= 0, z <= ceiling])
