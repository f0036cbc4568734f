"""Share problem: water-filling, the back ends, and the check of their answers."""

from __future__ import annotations

import math
import subprocess
import sys
from bisect import bisect_right
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.settings import Backend
from arpd.solve.checked import CheckedSolver, load
from arpd.solve.exact import water_fill
from arpd.solve.problem import Infeasible, ShareProblem, Solved, SolverFailed, checked, disagreement
from tests.examples import examples

WHOLE = 10**9


@st.composite
def share_problems(draw, max_topics=12):
    rows = draw(
        st.lists(
            st.tuples(st.integers(200, 20_000), st.integers(1000, WHOLE), st.fractions(0, 1)),
            min_size=1,
            max_size=max_topics,
        )
    )
    hi = [high for _, high, _ in rows]
    lo = [int(high * part) for _, high, part in rows]
    floors = sum(lo)
    budget = draw(st.one_of(st.integers(floors, floors + WHOLE), st.just(max(1, floors)), st.just(sum(hi))))
    return ShareProblem(
        weights=tuple(w for w, _, _ in rows), lo=tuple(lo), hi=tuple(hi), budget=max(1, budget), whole=WHOLE
    )


def shares(*, weights, lo, hi, budget):
    """Return a problem of decimal shares and small whole weights."""
    return ShareProblem(
        weights=tuple(weights),
        lo=tuple(round(low * WHOLE) for low in lo),
        hi=tuple(round(high * WHOLE) for high in hi),
        budget=round(budget * WHOLE),
        whole=WHOLE,
    )


def simple(**fields):
    return shares(**{"weights": (1, 1), "lo": (0.1, 0.1), "hi": (0.9, 0.9), "budget": 0.8, **fields})


def exactly(problem):
    """Return water-filling by its definition: bisect the level among the breakpoints, in rationals."""

    def clipped(level):
        rows = zip(problem.weights, problem.lo, problem.hi, strict=True)
        return [min(max(level * weight, Fraction(low)), Fraction(high)) for weight, low, high in rows]

    if sum(problem.hi) <= problem.budget:
        return clipped(max(Fraction(high, weight) for high, weight in zip(problem.hi, problem.weights, strict=True)))
    points = sorted(
        {Fraction(b, w) for bs in (problem.lo, problem.hi) for b, w in zip(bs, problem.weights, strict=True)}
    )
    filled = [sum(clipped(point)) for point in points]
    piece = bisect_right(filled, problem.budget) - 1
    if piece < 0:
        return clipped(Fraction(0))
    rise = Fraction(filled[piece + 1] - filled[piece], points[piece + 1] - points[piece])
    return clipped(points[piece] + (problem.budget - filled[piece]) / rise)


def answer(backend, problem):
    outcome = load(backend).solve(problem)
    assert isinstance(outcome, Solved)
    return outcome.values


class Liar:
    """A back end that returns a given outcome."""

    name = Backend.OSQP

    def __init__(self, outcome):
        self.outcome = outcome

    def solve(self, problem):
        return self.outcome


@examples(100)
@given(share_problems())
def test_the_level_alone_tells_every_share(problem):
    """clip(ν·w, lo, hi) is the solution, also where no share is at the level, and infinite only where all have all."""
    fill = water_fill(problem)
    level = fill.level_per_weight * problem.whole
    rows = zip(problem.weights, problem.lo, problem.hi, fill.shares(), strict=True)
    for weight, low, high, share in rows:
        assert min(max(level * weight, low), high) == pytest.approx(share * problem.whole, rel=1e-12)
    if math.isinf(level):
        assert sum(problem.hi) <= problem.budget


@examples(80)
@given(problem=share_problems(max_topics=40))
def test_water_filling_is_its_definition(problem):
    """Variable fixing gives exactly e = clip(ν·w, lo, hi) with Σ e = min(B, Σ hi), as rationals."""
    filled = [Fraction(*ratio) for ratio in water_fill(problem).ratios()]
    assert filled == exactly(problem)
    assert sum(filled) == min(problem.budget, sum(problem.hi))


def test_osqp_writes_nothing(capfd):
    """OSQP writes nothing to stdout, which belongs to ``--json``, even where no constraint binds."""
    for hi in (1.0, 0.5, 0.1):
        load(Backend.OSQP).solve(simple(weights=(1,), lo=(0.0,), hi=(hi,), budget=1.0))
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("backend", Backend)
def test_floors_above_the_budget_are_infeasible(backend):
    """Floors above the budget are infeasible, and floors that fill it exactly are the answer."""
    assert isinstance(load(backend).solve(simple(budget=0.1)), Infeasible)
    assert load(backend).solve(simple(budget=0.2)) == Solved(values=(0.1, 0.1))


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        ((math.nan, 0.4), "not one number per topic"),
        ((0.4,), "not one number per topic"),
        ((0.5, 0.5), "constraints are violated by 0.2"),
        ((0.0, 0.4), "constraints are violated by 0.1"),
        ((0.95, -0.2), "constraints are violated by 0.3"),
        ((0.5, 0.3), "not at one level"),
        ((0.3, 0.3), "0.2 of the budget is not handed out"),
        ((0.1, 0.1), "not handed out"),
    ],
    ids=str,
)
def test_a_vector_that_is_not_feasible_and_optimal_is_a_failure(values, fault):
    """A vector outside the constraints, off the common level, or below the budget is never Solved."""
    outcome = checked(simple(), values, solver="test")
    assert isinstance(outcome, SolverFailed)
    assert fault in outcome.reason


@examples(80)
@given(problem=share_problems())
def test_the_exact_answer_passes_the_check_of_the_others(problem):
    """The exact answer is at one level, at any bounds of its shares."""
    assert isinstance(checked(problem, water_fill(problem).shares(), solver="test", parts=1000), Solved)


@pytest.mark.parametrize(
    ("outcome", "disagreements"),
    [(Solved(values=(0.5, 0.3)), 1), (SolverFailed(reason="test"), 0), (Infeasible(reason="test"), 0)],
)
def test_a_wrong_back_end_is_overruled_and_counted(outcome, disagreements):
    """The exact answer replaces one that is not optimal, a failure, and a claim that the problem is infeasible."""
    solver = CheckedSolver(Liar(outcome))
    assert solver.solve(simple()) == (water_fill(simple()), Backend.EXACT)
    assert solver.disagreements == disagreements
    assert solver.outcomes == {("osqp", outcome.kind): 1, ("exact", "solved"): 1}


def test_an_agreeing_back_end_gets_the_credit():
    """The published number is the exact one near the floats of the back end, in the name of the back end."""
    solver = CheckedSolver(Liar(Solved(values=(0.4 + 1e-9, 0.4 - 1e-9))))
    assert solver.solve(simple()) == (water_fill(simple()), Backend.OSQP)
    assert solver.outcomes == {("osqp", "solved"): 1}


def test_an_infeasible_problem_is_an_error_of_the_caller():
    """The caller decides feasibility first, so floors above the budget raise."""
    with pytest.raises(ValueError, match="floors need"):
        CheckedSolver(load(Backend.EXACT)).solve(simple(budget=0.1))


def test_a_small_topic_cannot_hide_in_the_absolute_tolerance():
    """A share of 1e-5 that is 5 % off disagrees although it is only 5e-7 away."""
    assert disagreement((1.05e-5, 0.5), (1e-5, 0.5))


def test_importing_the_program_loads_no_solver_library():
    """Importing the program loads neither numpy, osqp nor cvxpy, and the OSQP back end does not load cvxpy."""
    script = (
        "import sys, arpd.solve.program, arpd.solve.eq4\n"
        "assert not {'osqp', 'cvxpy', 'numpy', 'scipy'} & set(sys.modules)\n"
        "from arpd.solve.checked import load; load('osqp')\n"
        "assert 'osqp' in sys.modules and 'cvxpy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.parametrize("error", [RuntimeError("a bug"), MemoryError(), KeyError("x")])
def test_exact_answers_when_a_back_end_raises(caplog, error):
    """Exact answers at any exception, which is counted every time and logged once."""

    class Throwing:
        name = Backend.OSQP

        def solve(self, problem):
            raise error

    problem = shares(weights=[1, 2], lo=[0.0, 0.0], hi=[1.0, 1.0], budget=0.9)
    solver = CheckedSolver(Throwing())
    for _ in range(3):
        assert solver.solve(problem) == (water_fill(problem), Backend.EXACT)
    assert solver.outcomes == {("osqp", "failed"): 3, ("exact", "solved"): 3}
    assert len(caplog.records) == 1
