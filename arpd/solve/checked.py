"""Checked back ends of the program: every answer is compared with ``exact``.

Importing this module loads neither osqp nor cvxpy; `load` imports the library of the back end it returns.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, TypeVar

from arpd.model.settings import Backend
from arpd.solve.eq4 import Eq4Status, solve_eq4
from arpd.solve.exact import ExactSolver, WaterFill, water_fill
from arpd.solve.problem import (
    Infeasible,
    Outcome,
    ShareProblem,
    Solved,
    Solver,
    SolverFailed,
    disagreement,
    infeasibility,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.solve.eq4 import Eq4Problem, Eq4Solution

log = logging.getLogger(__name__)
T = TypeVar("T")


def load(backend: Backend) -> Solver:
    """Return a new solver of a back end, and import its library if it has one."""
    solver: Solver
    match backend:
        case Backend.EXACT:
            solver = ExactSolver()
        case Backend.OSQP:
            solver = import_module("arpd.solve.osqp_").OsqpSolver()
        case Backend.CVXPY:
            solver = import_module("arpd.solve.cvxpy_").CvxpySolver()
    return solver


class CheckedSolver:
    """Back end whose every answer is compared with ``exact``, which takes over when it fails or differs.

    Where both agree, the back end gets the credit, and the exact number near its floats is published. So no deadline
    depends on the last digit of a solver, or on the choice of the solver.

    Parameters
    ----------
    solver : the back end that answers first
    """

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._outcomes: Counter[tuple[str, str]] = Counter()
        self._disagreements = 0
        self._fault = ""

    @property
    def name(self) -> Backend:
        """Back end that answers first."""
        return self._solver.name

    @property
    def outcomes(self) -> Mapping[tuple[str, str], int]:
        """Copy of the counts (back end, ``solved`` | ``infeasible`` | ``failed``) since start."""
        return dict(self._outcomes)

    @property
    def disagreements(self) -> int:
        """Number of answers that passed the residual check and still differed from ``exact``."""
        return self._disagreements

    def note_infeasible(self) -> None:
        """Count a problem that analysis found infeasible, so no back end was called."""
        self._outcomes[self.name, Infeasible.kind] += 1

    def solve(self, problem: ShareProblem) -> tuple[WaterFill, Backend]:
        """Return the exact shares of a feasible ``problem``, and the back end that gets the credit."""
        if infeasible := infeasibility(problem):
            raise ValueError(f"the problem must be feasible: {infeasible.reason}")
        fill = water_fill(problem)
        if self.name is not Backend.EXACT:
            outcome = self._ask(problem)
            self._outcomes[self.name, outcome.kind] += 1
            if isinstance(outcome, Solved):
                if not disagreement(outcome.values, fill.shares()):
                    return fill, self.name
                self._disagreements += 1
        self._outcomes[Backend.EXACT, Solved.kind] += 1
        return fill, Backend.EXACT

    def solve_eq4(self, problem: Eq4Problem) -> Eq4Solution:
        """Return the solution of Eq. (4); ``exact`` takes over when the back end fails or differs."""
        solution = self._tried(lambda: solve_eq4(problem, self.name))
        if isinstance(solution, SolverFailed):
            solution = replace(solve_eq4(problem), agreed=False)
        if solution.status is Eq4Status.INFEASIBLE:
            self.note_infeasible()
            return solution
        if not solution.agreed:
            self._outcomes[self.name, SolverFailed.kind] += 1
        self._outcomes[solution.backend, Solved.kind] += 1
        return solution

    def _ask(self, problem: ShareProblem) -> Outcome:
        return self._tried(lambda: self._solver.solve(problem))

    def _tried(self, ask: Callable[[], T]) -> T | SolverFailed:
        try:
            return ask()
        except Exception as error:  # a library may raise anything; exact has the answer already
            if (reason := f"{self.name}: {type(error).__name__}: {error}") != self._fault:
                self._fault = reason
                log.exception("%s; exact takes over", reason)
            return SolverFailed(reason=reason)
