"""OSQP, called directly on the share-scaled program (Stellato et al., OSQP, Math. Prog. Comp. 2020).

The trailing underscore keeps ``import osqp`` here from meaning this module.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import osqp
from scipy import sparse

from arpd.model.settings import Backend
from arpd.solve.problem import Outcome, ShareProblem, Solved, SolverFailed, checked, infeasibility
from arpd.solve.scaling import BLEND, Frame, ShareUnits, settled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from arpd.solve.eq4 import Eq4Problem

#: ADMM stops at each of these in turn and OSQP polishes, until the polished point passes our own check.
_STEPS = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
#: A polished point passes a check a hundred times stricter than needed; a lesser one counts only where none does.
_STRICT = 1000
#: First from the end of the last problem; then from zero, with these values of ρ.
_RESTARTS: tuple[float | None, ...] = (None, 0.01, 1000.0, 1.0, 100.0)
#: Statements of the same problem, tried in turn. Where the budget nearly equals the floors or the ceilings, one in 500
#: problems over six decades fails in the first statement, one in 2,000 in the second, and hardly any in both.
_STATEMENTS: tuple[tuple[float, Callable[[ShareUnits, ShareProblem], Frame]], ...] = (
    (BLEND, ShareUnits.from_nothing),
    (BLEND, ShareUnits.from_floors),
    (0.5, ShareUnits.from_floors),
    (0.5, ShareUnits.from_nothing),
)
#: ρ adapts at a fixed interval of iterations, so the same sequence of problems takes the same course. Every problem is
#: feasible, so OSQP's search for proofs of infeasibility is off: it found some.
OPTIONS: dict[str, float | int | bool] = {
    "rho": 10.0,
    "adaptive_rho": True,
    "adaptive_rho_interval": 25,
    "adaptive_rho_tolerance": 2.0,
    "check_termination": 5,
    "check_dualgap": False,
    "eps_abs": _STEPS[0],
    "eps_rel": 0.0,
    "eps_prim_inf": 1e-30,
    "eps_dual_inf": 1e-30,
    "max_iter": 4000,
    "polishing": True,
    "polish_refine_iter": 10,
    "scaling": 0,
    "warm_starting": True,
    "verbose": False,
}

#: Of 500 random feasible problems 23 end at ``max_iter`` with ρ fixed, and none with ρ adapted.
OPTIONS_EQ4 = OPTIONS | {"rho": 1.0, "eps_abs": 1e-6, "adaptive_rho_tolerance": 5.0, "polish_refine_iter": 3}


class OsqpSolver:
    """Keeps one factorisation while the weights stay, updates only q, l and u, and starts where it ended.

    (G1) and (G2) have the same weights, so one workspace serves both. After warm starts the last digits depend on
    earlier problems; published numbers do not, see ``CheckedSolver``.
    """

    name = Backend.OSQP

    def __init__(self) -> None:
        self._weights: tuple[int, ...] = ()
        self._workspaces: dict[float, _Workspace] = {}

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem`` and re-check the residuals of the answer."""
        if infeasible := infeasibility(problem):
            return infeasible
        if (known := settled(problem)) is not None:
            return Solved(values=tuple(known))
        if problem.weights != self._weights:
            self._weights, self._workspaces = problem.weights, {}
        best: Outcome = SolverFailed(reason="osqp: nothing solved")
        try:
            for blend, measured in _STATEMENTS:
                if blend not in self._workspaces:
                    self._workspaces[blend] = _Workspace(ShareUnits.of(problem.weights, blend=blend))
                workspace = self._workspaces[blend]
                frame = measured(workspace.units, problem)
                for point in workspace.points(frame):
                    shares = workspace.units.shares(frame, point)
                    if isinstance(good := checked(problem, shares, solver="osqp", parts=_STRICT), Solved):
                        return good
                    if not isinstance(best, Solved):
                        best = checked(problem, shares, solver="osqp")
        except (osqp.OSQPException, ValueError) as error:
            best = SolverFailed(reason=f"osqp: {type(error).__name__}: {error}")
        self._workspaces = {}  # the next problem does not start from here
        return best


class _Workspace:
    """OSQP set up for one set of units."""

    def __init__(self, units: ShareUnits) -> None:
        self.units = units
        count = len(units.row)
        rows = sparse.vstack([units.row.reshape(1, -1), sparse.identity(count)], format="csc")
        self._osqp = osqp.OSQP()
        self._osqp.setup(
            P=sparse.diags(units.curvature, format="csc"),
            q=np.zeros(count),
            A=rows,
            l=np.zeros(count + 1),
            u=np.ones(count + 1),
            **OPTIONS,
        )
        self._eps = _STEPS[0]

    def points(self, frame: Frame) -> Iterator[NDArray[np.float64]]:
        """Yield the points that OSQP calls solved, with ever smaller eps."""
        self._osqp.update(q=frame.slope, l=np.concatenate(([1.0], frame.lower)), u=np.concatenate(([1.0], frame.upper)))
        count = len(frame.slope)
        for rho in _RESTARTS:
            if rho is not None:
                self._osqp.warm_start(x=np.zeros(count), y=np.zeros(count + 1))
                self._osqp.update_settings(rho=rho)
            for eps in _STEPS:
                if eps != self._eps:
                    self._osqp.update_settings(eps_abs=eps)
                    self._eps = eps
                result = self._osqp.solve(raise_error=False)
                # Necessary, not sufficient: without new data OSQP keeps its old status.
                if result.info.status_val == osqp.SolverStatus.OSQP_SOLVED:
                    yield result.x


def solve_eq4(problem: Eq4Problem) -> Outcome:
    """Solve Eq. (4) in the shares e = R/Rmax and g = D/Dmax; return (R, D).

    OSQP fails on the LP as printed (its columns differ by Dmax/Rmax and it has no curvature). The vertex of Eq. (4) is
    greater in both coordinates than any other feasible point: (2) bounds R alone and (3) lets D grow with R. So every
    objective that increases in both picks it. This one is strictly convex: min (e² + g²)/2 − (e + g), for e, g < 1.
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
