"""cvxpy: the readable statement of the mathematics, for teaching and cross-checks, not for the tick.

Import this module only on demand: it costs about 2 s, and 82 MiB in `arpd run`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np

from arpd.model.settings import Backend
from arpd.solve.problem import Outcome, ShareProblem, Solved, SolverFailed, checked, infeasibility
from arpd.solve.scaling import Frame, ShareUnits, settled

if TYPE_CHECKING:
    from arpd.solve.eq4 import Eq4Problem

#: DAQP is an active-set method (Arnström, Bemporad & Axehill, IEEE TAC 2022). So this back end shares no algorithm with
#: the other two, and its answers lie on the constraints: of 7,000 problems with weights over six decades it left none
#: unsolved and none off by 1e-6. It is dense; above a hundred topics the interior-point method Clarabel takes over,
#: which loses some digits of shares that just touch a bound.
MOST_DENSE = 100
CLARABEL: dict[str, Any] = {"solver": cp.CLARABEL, "tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
DAQP: dict[str, Any] = {"solver": cp.DAQP, "primal_tol": 1e-10}


class CvxpySolver:
    """Parametrised (DPP) problem per number of topics; weights and bounds are its Parameters."""

    name = Backend.CVXPY

    def __init__(self) -> None:
        self._problem: Any = None
        self._count = 0

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem`` and re-check the residuals of the answer."""
        if infeasible := infeasibility(problem):
            return infeasible
        if (known := settled(problem)) is not None:
            return Solved(values=tuple(known))
        if self._count != len(problem.weights):
            self._count = len(problem.weights)
            self._problem = _state(self._count)
        units = ShareUnits.of(problem.weights)
        outcome: Outcome = SolverFailed(reason="cvxpy: nothing solved")
        for frame in (units.from_floors(problem), units.from_nothing(problem)):
            outcome = self._solve(problem, units, frame)
            if isinstance(outcome, Solved):
                break
        return outcome

    def _solve(self, problem: ShareProblem, units: ShareUnits, frame: Frame) -> Outcome:
        root = np.sqrt(units.curvature)
        self._problem.param_dict["slope"].value = frame.slope / root
        self._problem.param_dict["row"].value = units.row / root
        self._problem.param_dict["lower"].value = root * frame.lower
        self._problem.param_dict["upper"].value = root * frame.upper
        try:
            self._problem.solve(**(DAQP if self._count <= MOST_DENSE else CLARABEL))
        except (cp.error.SolverError, ValueError) as error:
            return SolverFailed(reason=f"cvxpy: {type(error).__name__}: {error}")
        if self._problem.status != cp.OPTIMAL:  # .value is set even then
            return SolverFailed(reason=f"cvxpy: {self._problem.status}")
        point = self._problem.var_dict["z"].value / root
        return checked(problem, units.shares(frame, point), solver="cvxpy")


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


def _state(count: int) -> Any:
    """State the problem of ``Frame`` for a number of topics, in z = √p·x.

    With x itself, cvxpy would add variables without curvature, and DAQP would smooth them at the cost of six digits.
    """
    z = cp.Variable(count, name="z")
    slope = cp.Parameter(count, name="slope", nonneg=True)
    row = cp.Parameter(count, name="row", nonneg=True)
    lower, upper = cp.Parameter(count, name="lower", nonneg=True), cp.Parameter(count, name="upper", nonneg=True)
    return cp.Problem(cp.Minimize(cp.sum_squares(z) / 2 + slope @ z), [row @ z == 1, lower <= z, z <= upper])
