"""Who answers: the back end of the configuration, and the closed form where that fails."""

import math
import subprocess
import sys

import numpy as np
import pytest

from arpd.model.settings import Backend
from arpd.solve import osqp_
from arpd.solve.backends import Solver
from arpd.solve.eq4 import Eq4Problem
from arpd.solve.level import TOLERANCE, water_level

WEIGHTS, LOW, HIGH, BUDGET = np.array([1.0, 2.0]), np.array([0.1, 0.1]), np.array([0.9, 0.9]), 0.6
LEVEL = 0.2


def broken(answer):
    """Return a back end's function that returns an answer, or raises it."""

    def function(*_):
        if isinstance(answer, Exception | MemoryError):
            raise answer
        return answer

    return function


@pytest.mark.parametrize(
    ("answer", "outcome"),
    [
        (LEVEL * (1 + 1e-5), "disagreed"),
        (0.0, "disagreed"),
        (math.inf, "disagreed"),
        (math.nan, "failed"),
        (RuntimeError("a bug"), "failed"),
        (MemoryError(), "failed"),
    ],
    ids=repr,
)
def test_a_wrong_back_end_is_overruled_and_counted(monkeypatch, caplog, answer, outcome):
    """The closed form answers; every fault is counted by its kind, and what a library raises is logged once."""
    monkeypatch.setattr(osqp_, "level", broken(answer))
    solver = Solver(Backend.OSQP)
    for _ in range(3):
        level, backend = solver.level(WEIGHTS, LOW, HIGH, BUDGET)
        assert (level, backend) == (pytest.approx(LEVEL, rel=1e-12), Backend.CLOSED_FORM)
    assert solver.outcomes == {("osqp", outcome): 3, ("closed_form", "solved"): 3}
    assert len(caplog.records) == isinstance(answer, Exception)


@pytest.mark.parametrize(("answer", "outcome"), [((5.0, 200.0), "disagreed"), ((7.0, math.nan), "failed")])
def test_a_wrong_optimum_of_eq4_is_overruled_and_counted(monkeypatch, answer, outcome):
    """A point that is not the vertex is replaced by it, also where it is feasible."""
    monkeypatch.setattr(osqp_, "eq4", broken(answer))
    solver = Solver(Backend.OSQP)
    (rate_hz, depth), backend = solver.eq4(Eq4Problem(max_rate_hz=100, topics=12))
    assert (int(rate_hz), int(depth), backend) == (7, 365, Backend.CLOSED_FORM)
    assert solver.outcomes == {("osqp", outcome): 1, ("closed_form", "solved"): 1}


@pytest.mark.parametrize("budget", [2.0, 1.8, 1.8 * (1 - 1e-7), 0.2, 0.2 * (1 + 1e-7)])
def test_nobody_is_asked_where_all_or_nothing_fits(monkeypatch, budget):
    """With all ceilings ν is infinite, with the floors alone they are the answer; neither needs a solver."""
    monkeypatch.setattr(osqp_, "level", broken(RuntimeError("asked")))
    solver = Solver(Backend.OSQP)
    level, backend = solver.level(WEIGHTS, LOW, HIGH, budget)
    assert math.isinf(level) == (budget > 1.0)
    assert math.isinf(water_level(WEIGHTS, LOW, HIGH, budget)) == (budget >= HIGH.sum())
    assert np.clip(level * WEIGHTS, LOW, HIGH).sum() == pytest.approx(min(budget, 1.8), rel=TOLERANCE)
    assert (backend, solver.outcomes) == (None, {})


def test_while_its_library_loads_the_closed_form_answers_and_nothing_has_failed():
    """A daemon loads a library in a thread, and plans meanwhile."""
    modules = [None, osqp_]
    solver = Solver(Backend.OSQP, load=lambda _name: modules.pop(0))
    answers = [solver.level(WEIGHTS, LOW, HIGH, BUDGET) for _ in range(2)]
    assert [backend for _, backend in answers] == [Backend.CLOSED_FORM, Backend.OSQP]
    assert solver.outcomes == {("closed_form", "solved"): 1, ("osqp", "solved"): 1}


def test_importing_the_program_loads_no_solver_library():
    """Importing the program loads neither OSQP nor cvxpy, and a solver that is asked loads its own library alone."""
    script = (
        "import sys, arpd.solve.program\n"
        "assert not {'osqp', 'cvxpy', 'scipy'} & set(sys.modules)\n"
        "from arpd.solve.backends import Solver; from arpd.solve.eq4 import Eq4Problem; solver = Solver('osqp')\n"
        "assert 'osqp' not in sys.modules\n"
        "solver.eq4(Eq4Problem(max_rate_hz=100, topics=12))\n"
        "assert 'osqp' in sys.modules and 'cvxpy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
