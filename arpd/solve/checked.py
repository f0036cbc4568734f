"""Back ends for the DEPTH/DEADLINE program, one module each, and the judge that checks their answers.

Importing this package loads neither osqp nor cvxpy; ``load`` does, when that back end is asked for.
"""

from __future__ import annotations

import logging
from collections import Counter
from importlib import import_module
from typing import TYPE_CHECKING

from arpd.model.settings import Backend
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
    from collections.abc import Mapping

log = logging.getLogger(__name__)


def load(backend: Backend) -> Solver:
    """Return a new solver of that kind, importing its library if it has one."""
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
    """A back end whose every answer is compared with ``exact``, which takes over when it fails or differs.

    Where both agree, the back end has the credit and what is published is the exact number that its floats are near:
    whether a deadline is one nanosecond longer must not hang on a solver's last digit, nor on which solver it was.

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
        """The back end that answers first."""
        return self._solver.name

    @property
    def outcomes(self) -> Mapping[tuple[str, str], int]:
        """Copy of the counts (back end, ``solved`` | ``infeasible`` | ``failed``) since start."""
        return dict(self._outcomes)

    @property
    def disagreements(self) -> int:
        """Answers that passed the residual check and still differed from ``exact``."""
        return self._disagreements

    def note_infeasible(self) -> None:
        """Count a problem that analysis found infeasible before any back end was called."""
        self._outcomes[self.name, Infeasible.kind] += 1

    def solve(self, problem: ShareProblem) -> tuple[WaterFill, Backend]:
        """Return the exact shares of a feasible ``problem``, and the back end that found them."""
        if verdict := infeasibility(problem):
            raise ValueError(f"the problem must be feasible: {verdict.reason}")
        filling = water_fill(problem)
        if self.name is not Backend.EXACT:
            outcome = self._ask(problem)
            self._outcomes[self.name, outcome.kind] += 1
            if isinstance(outcome, Solved):
                if not disagreement(outcome.values, filling.shares()):
                    return filling, self.name
                self._disagreements += 1
        self._outcomes[Backend.EXACT, Solved.kind] += 1
        return filling, Backend.EXACT

    def _ask(self, problem: ShareProblem) -> Outcome:
        try:
            return self._solver.solve(problem)
        except Exception as error:  # whatever a library throws, exact has the answer already
            if (reason := f"{self.name}: {type(error).__name__}: {error}") != self._fault:
                self._fault = reason
                log.exception("%s; exact takes over", reason)
            return SolverFailed(reason=reason)
