"""Back ends for the DEPTH/DEADLINE program, one module each, and the judge that checks their answers.

Importing this package loads neither osqp nor cvxpy; ``load`` does, when that back end is asked for.
"""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from typing import TYPE_CHECKING

from arpd.settings import Backend
from arpd.solvers.exact import ExactSolver
from arpd.solvers.outcome import (
    Infeasible,
    Outcome,
    ShareProblem,
    Solved,
    Solver,
    SolverFailed,
    disagreement,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["CheckedSolver", "Infeasible", "Outcome", "ShareProblem", "Solved", "Solver", "SolverFailed", "load"]


def load(backend: Backend) -> Solver:
    """Return a new solver of that kind, importing its library if it has one."""
    solver: Solver
    match backend:
        case Backend.EXACT:
            solver = ExactSolver()
        case Backend.OSQP:
            solver = import_module("arpd.solvers.osqp_").OsqpSolver()
        case Backend.CVXPY:
            solver = import_module("arpd.solvers.cvxpy_").CvxpySolver()
    return solver


class CheckedSolver:
    """A back end whose every answer is compared with ``exact``, which takes over when it fails or differs.

    The published vector is the back end's own when both agree. It is settled on the bounds and inside the budget, and
    a function of the problem alone, so ticks with the same inputs plan the same QoS.

    Parameters
    ----------
    solver : the back end that answers first
    """

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._exact = ExactSolver()
        self._outcomes: Counter[tuple[str, str]] = Counter()
        self._disagreements = 0

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

    def solve(self, problem: ShareProblem) -> tuple[tuple[float, ...], Backend]:
        """Return the shares of a feasible ``problem`` and the back end they came from."""
        outcome = self._solver.solve(problem)
        self._outcomes[self.name, outcome.kind] += 1
        if self.name is Backend.EXACT and isinstance(outcome, Solved):
            return outcome.values, self.name
        reference = self._exact.solve(problem)
        if not isinstance(reference, Solved):
            raise ValueError(f"the problem must be feasible: {reference.reason}")  # noqa: TRY004 a value is wrong
        if isinstance(outcome, Solved):
            if not disagreement(outcome.values, reference.values):
                return outcome.values, self.name
            self._disagreements += 1
        self._outcomes[Backend.EXACT, reference.kind] += 1
        return reference.values, Backend.EXACT
