"""Every back end against the exact one, over everything a configuration and a link can ask for."""

from __future__ import annotations

from bisect import bisect_right

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from arpd.settings import Backend
from arpd.solvers import ShareProblem, Solved, load, water_fill

WHOLE = 10**15
LIGHTEST, HEAVIEST = 1, 10**6  # the configuration admits weights of 0.001 to 1000
#: The same 5,000 at every run: a back end that fails one in a million is reported by its counter, not by a red CI.
INSTANCES = 5000

decades = st.floats(0.0, 6.0)
weights = st.one_of(
    decades.map(lambda power: round(10**power)), st.sampled_from([LIGHTEST, 1000, 2000, 5000, HEAVIEST])
)
ceilings = st.one_of(decades.map(lambda power: round(WHOLE / 10**power)), st.just(WHOLE), st.just(WHOLE // 10))
floors = st.one_of(st.just(0.0), st.just(1.0), st.floats(0.0, 1.0))  # parts of the ceiling


@st.composite
def wide_problems(draw):
    """Draw ties, identical topics, floors that meet ceilings, budgets that just do or just do not bind."""
    rows = draw(st.lists(st.tuples(weights, ceilings, floors), min_size=1, max_size=20))
    if draw(st.booleans()):
        rows *= 2
    hi = [high for _, high, _ in rows]
    lo = [min(high, round(high * part)) for _, high, part in rows]
    least, most = sum(lo), sum(hi)
    budget = draw(
        st.one_of(
            st.floats(0.0, 1.0).map(lambda part: least + round((most - least) * part)),
            st.sampled_from([least, least + 1, most - 1, most, most + 1, WHOLE]),
        )
    )
    if least > budget:  # infeasible ones never reach a back end
        scale = bisect_right(range(1000), budget, key=lambda part: sum(low * part // 1000 for low in lo)) - 1
        lo = [low * max(0, scale) // 1000 for low in lo]
    return ShareProblem(
        weights=tuple(weight for weight, _, _ in rows),
        lo=tuple(lo),
        hi=tuple(hi),
        budget=max(1, budget, sum(lo)),
        whole=max(WHOLE, budget),
    )


@pytest.mark.timeout(600)
@pytest.mark.parametrize("backend", [Backend.OSQP, Backend.CVXPY])
def test_every_back_end_agrees_with_exact(backend):
    """On 5,000 instances with weights and ceilings over six decades none is unsolved, and no share is off by 1e-6."""
    solver = load(backend)

    @settings(
        max_examples=INSTANCES, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(problem=wide_problems())
    def agree(problem):
        nonlocal instances
        instances += 1
        outcome = solver.solve(problem)
        assert isinstance(outcome, Solved), outcome
        truth = water_fill(problem).shares()
        assert max(abs(value - share) for value, share in zip(outcome.values, truth, strict=True)) <= 1e-6

    instances = 0
    agree()
    assert instances >= INSTANCES
