"""Every back end against the closed form, over all that a configuration and a link can ask for."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.settings import Backend
from arpd.solve import cvxpy_, osqp_
from arpd.solve.backends import Solver
from arpd.solve.level import TOLERANCE, water_level
from tests.examples import examples
from tests.unit.solve.test_eq4 import problems

LIBRARIES = {Backend.OSQP: osqp_, Backend.CVXPY: cvxpy_}


def wide(rng):
    """Draw weights and ceilings over six decades, ties, floors at ceilings, and budgets that nearly bind."""
    count = rng.choice([1, 1, 2, 3, 4, 6, 8, 12, 20])
    weights = [rng.choice([10 ** rng.uniform(-3, 3), 0.001, 1.0, 2.0, 5.0, 1000.0]) for _ in range(count)]
    high = [rng.choice([10 ** -rng.uniform(0, 6), 1.0, 0.1]) for _ in range(count)]
    low = [most * rng.choice([0.0, 1.0, rng.random(), rng.random() ** 4]) for most in high]
    if rng.random() < 0.3:
        weights, high, low = weights * 2, high * 2, low * 2
    room = sum(high) - sum(low)
    part = rng.choice([rng.random(), rng.random(), 10 ** -rng.uniform(0, 6), 1.0 - 10 ** -rng.uniform(0, 6)])
    return np.array(weights), np.array(low), np.array(high), sum(low) + part * room


def robot(rng):
    """Draw the link of a robot: small fast topics and large slow ones, a few with more weight."""
    count = rng.choice([1, 3, 12, 12, 30, 100])
    costs = np.array([10 ** rng.uniform(2.4, 4.6) for _ in range(count)])
    wishes = np.array([10 ** rng.uniform(0.0, 2.0) for _ in range(count)])
    floors = np.minimum(wishes, [rng.choice([0.0, 0.5, 1.0]) for _ in range(count)])
    weights = np.array([rng.choice([0.1, 1.0, 1.0, 1.0, 2.0, 4.0, 10.0]) for _ in range(count)])
    costs /= float(costs @ wishes) * rng.uniform(0.1, 1.2)
    return weights, costs * floors, np.minimum(1.0, costs * wishes), 0.85


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("backend", "draw", "instances", "most_failures"),
    [
        (Backend.OSQP, robot, 1000, 0),
        (Backend.CVXPY, robot, 200, 0),
        (Backend.OSQP, wide, 2000, 20),
        (Backend.CVXPY, wide, 300, 15),
    ],
)
def test_every_back_end_answers(backend, draw, instances, most_failures):
    """On the links of robots no answer is left to the closed form; of the oddest problems over six decades, few are."""
    # The same in every run and on every machine, which hypothesis does not promise.
    rng, solver = random.Random(20261121), Solver(backend)
    for _ in range(instances):
        solver.level(*draw(rng))
    assert solver.outcomes[backend, "failed"] + solver.outcomes[backend, "disagreed"] <= most_failures
    assert solver.outcomes[backend, "solved"] > 0.5 * instances


@examples(150)
@given(seed=st.integers(0, 2**64), backend=st.sampled_from([*LIBRARIES]), draw=st.sampled_from([robot, wide]))
def test_a_back_end_gives_the_shares_of_the_closed_form(seed, backend, draw):
    """Every share is that of the closed form to a millionth of the budget, wherever a back end's ν counts."""
    weights, low, high, budget = draw(random.Random(seed))
    level, closed = Solver(backend).level(weights, low, high, budget)[0], water_level(weights, low, high, budget)
    shares, truth = (np.clip(each * weights, low, high) for each in (level, closed))
    assert np.abs(shares - truth).max() <= 1.01 * TOLERANCE * budget


@examples(150)
@given(problem=problems, backend=st.sampled_from([*LIBRARIES]))
def test_a_back_end_finds_the_vertex_of_eq4(problem, backend):
    """Whatever Eq. (4) has a solution, a back end finds it, and the closed form is not needed."""
    if not problem.refusal():
        (rate_hz, depth), answered = Solver(backend).eq4(problem)
        assert answered is backend
        assert rate_hz == pytest.approx(problem.vertex()[0], abs=TOLERANCE * problem.max_rate_hz)
        assert depth == pytest.approx(problem.vertex()[1], abs=TOLERANCE * problem.max_depth)
        assert math.isfinite(rate_hz)
