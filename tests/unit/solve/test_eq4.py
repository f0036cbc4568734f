"""Eq. (4) as published, with every back end."""

from fractions import Fraction

import pytest
from hypothesis import strategies as st

from arpd.model.plan import rate_of
from arpd.model.settings import Backend
from arpd.solve.backends import Solver
from arpd.solve.eq4 import Eq4Problem, period_ns, whole

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
    """Every back end gives each row of the paper's Table 2 by itself."""
    max_rate_hz, rate_floor, depth_floor, rate, depth = row
    problem = Eq4Problem(max_rate_hz=max_rate_hz, topics=12)
    answer, used = Solver(backend).eq4(problem)
    assert used is backend
    assert answer == pytest.approx((float(rate), float(depth)), rel=1e-6)
    assert (whole(answer[0]), whole(answer[1])) == (rate_floor, depth_floor)
    period, applied = problem.applied(answer[0])
    assert (period, applied) == (pytest.approx(10**9 / float(rate), rel=1e-6), depth_floor)


def test_too_many_topics_are_infeasible():
    """More topics than Rmax carries at Rmin give a refusal that names (2), a depth floor out of reach one for (3)."""
    assert Eq4Problem(max_rate_hz=20, topics=12).refusal().startswith("(2) leaves ")
    assert Eq4Problem(max_rate_hz=100, topics=12, min_depth=200).refusal().startswith("(3) leaves ")
    assert Eq4Problem(max_rate_hz=24, topics=12, min_depth=1).refusal() == ""


@pytest.mark.parametrize(
    ("rate_hz", "period"), [(0.0, 0), (2.0**-31, 0), (1e-30, 0), (50.0, 20_000_000), (0.5, 2 * 10**9)]
)
def test_a_period_above_a_dds_duration_is_a_pause(rate_hz, period):
    """A rate of 0, or one whose period exceeds 2³¹ − 1 seconds, is a pause."""
    assert period_ns(rate_hz) == period
    assert rate_of(0) == 0.0
