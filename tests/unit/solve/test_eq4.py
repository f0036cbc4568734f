"""Eq. (4) as published, with every back end."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.settings import Backend
from arpd.solve import osqp_
from arpd.solve.eq4 import Eq4Problem, Eq4Status, solve_eq4
from arpd.solve.problem import Solved
from arpd.solve.rows import rate_of, rational
from tests.examples import examples

TABLE_2 = [
    (100, 7, 365, Fraction(22, 3), Fraction(1097, 3)),
    (200, 15, 390, Fraction(47, 3), Fraction(1172, 3)),
    (500, 40, 405, Fraction(122, 3), Fraction(1217, 3)),
    (1000, 82, 410, Fraction(247, 3), Fraction(1232, 3)),
]

problems = st.builds(
    Eq4Problem,
    max_rate_hz=st.floats(1.0, 1e5),
    topics=st.integers(1, 200),
    min_rate_hz=st.floats(0.01, 20.0),
    min_depth=st.integers(1, 50),
    max_depth=st.integers(50, 10000),
)


@pytest.mark.parametrize("backend", Backend)
@pytest.mark.parametrize("row", TABLE_2, ids=str)
def test_table_2(backend, row):
    """With every back end each row of the paper's Table 2 is exact, and the back end agrees."""
    max_rate_hz, rate_floor, depth_floor, rate, depth = row
    solution = solve_eq4(Eq4Problem(max_rate_hz=max_rate_hz, topics=12), backend)
    assert solution.status is Eq4Status.OPTIMAL
    assert (solution.rate_hz_floor, solution.depth_floor) == (rate_floor, depth_floor)
    assert (solution.rate_hz, solution.depth) == (float(rate), float(depth))
    assert solution.deadline_ns == math.ceil(10**9 / rate)
    assert solution.depth_applied == depth_floor
    assert (solution.backend, solution.agreed) == (backend, True)


@pytest.mark.parametrize("backend", Backend)
@pytest.mark.parametrize("rate", [1, 2, 3, 7, 8, 9, 10, 29, 89, 99])
def test_integer_optimum_is_not_floored_away(backend, rate):
    """An optimum that is a whole number of Hz is shown as that number, not as the one below."""
    solution = solve_eq4(Eq4Problem(max_rate_hz=12 * (rate + 1), topics=12), backend)
    assert solution.rate_hz_floor == rate
    assert solution.deadline_ns == -(-(10**9) // rate)


@pytest.mark.parametrize("backend", Backend)
def test_too_many_topics_are_infeasible(backend):
    """More topics than Rmax carries at Rmin give an infeasible answer that names (2)."""
    solution = solve_eq4(Eq4Problem(max_rate_hz=20, topics=12), backend)
    assert solution.status is Eq4Status.INFEASIBLE
    assert solution.binding.startswith("(2)")
    assert (solution.rate_hz, solution.depth, solution.deadline_ns, solution.depth_applied) == (0.0, 0.0, 0, 0)


def test_depth_floor_out_of_reach_is_infeasible():
    """A depth floor above what (3) allows gives an infeasible answer that names (3)."""
    solution = solve_eq4(Eq4Problem(max_rate_hz=100, topics=12, min_depth=200))
    assert solution.status is Eq4Status.INFEASIBLE
    assert solution.binding.startswith("(3)")


def test_a_wrong_back_end_is_overruled(monkeypatch):
    """A back end that returns a feasible point that is not the optimum is replaced by the exact vertex."""
    monkeypatch.setattr(osqp_, "solve_eq4", lambda problem: Solved(values=(5.0, 200.0)))
    solution = solve_eq4(Eq4Problem(max_rate_hz=100, topics=12), Backend.OSQP)
    assert (solution.rate_hz_floor, solution.depth_floor) == (7, 365)
    assert (solution.backend, solution.agreed) == (Backend.EXACT, False)


@examples(150)
@given(problem=problems)
def test_exact_vertex_is_feasible_and_cannot_be_improved(problem):
    """The vertex satisfies Eq. (4) in exact arithmetic, and both (2) and (3) hold with equality there."""
    solution = solve_eq4(problem)
    rate, depth = problem.vertex()
    high, low = rational(problem.max_rate_hz), rational(problem.min_rate_hz)
    feasible = rate >= low and depth >= problem.min_depth
    assert (solution.status is Eq4Status.OPTIMAL) == feasible
    if feasible:
        assert high / problem.topics - rate == low
        assert problem.max_depth * rate / high - depth == problem.min_depth
        assert rate <= high
        assert depth <= problem.max_depth


@examples(150)
@given(problem=problems)
def test_applied_values_keep_the_link_and_depth_constraints(problem):
    """The applied period and depth satisfy (2) and (3) exactly, unless the depth is Dmin."""
    solution = solve_eq4(problem)
    if solution.status is Eq4Status.OPTIMAL:
        rate = Fraction(*rate_of(solution.deadline_ns))
        assert rate <= problem.vertex()[0]
        assert solution.depth_applied >= problem.min_depth
        if solution.depth_applied > problem.min_depth:
            assert solution.depth_applied <= problem.depth_limit(rate)


@examples(100)
@given(problem=problems)
def test_osqp_agrees_with_the_vertex(problem):
    """OSQP on the share-scaled problem finds the exact vertex for any feasible Eq. (4)."""
    assert solve_eq4(problem, Backend.OSQP).agreed


@pytest.mark.parametrize(
    "fields",
    [
        {"max_rate_hz": 0.0},
        {"max_rate_hz": math.inf},
        {"max_rate_hz": math.nan},
        {"min_rate_hz": 0.0},
        {"topics": 0},
        {"min_depth": 0},
        {"min_depth": 6000},
    ],
)
def test_nonsense_is_refused(fields):
    """A problem outside its range is refused when it is made."""
    with pytest.raises(ValueError):
        Eq4Problem(**{"max_rate_hz": 100.0, "topics": 12, **fields})
