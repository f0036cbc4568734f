"""Exact numbers: decimals, whole units, and periods that are never faster than the rate."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.solve.rows import decimal, period_ns, rate_of, whole

RATES = st.fractions(Fraction(1, 10**6), 10**6)


@pytest.mark.parametrize(("value", "exact"), [(0.85, (17, 20)), (1e-7, (1, 10**7)), (3, (3, 1)), (0.0, (0, 1))])
def test_a_float_is_the_decimal_one_reads(value, exact):
    """0.85 is 17/20, not the nearest binary fraction."""
    assert decimal(value) == exact


@given(st.lists(st.fractions(0, 1000), max_size=8))
def test_whole_numbers_lose_nothing(values):
    """The whole multiples equal the values."""
    numbers, scale = whole([value.as_integer_ratio() for value in values])
    assert [Fraction(number, scale) for number in numbers] == values


@given(RATES)
def test_a_period_is_the_shortest_whole_one_that_is_not_faster(rate_hz):
    """One nanosecond less would be faster than the rate."""
    period = period_ns(rate_hz.as_integer_ratio())
    assert Fraction(*rate_of(period)) <= rate_hz
    assert period == 1 or Fraction(10**9, period - 1) > rate_hz


@pytest.mark.parametrize(
    ("rate_hz", "period"), [((0, 1), 0), ((1, 2**31), 0), ((1, 10**30), 0), ((1, 2**31 - 1), (2**31 - 1) * 10**9)]
)
def test_a_period_above_a_dds_duration_is_a_pause(rate_hz, period):
    """A rate of 0, or one whose period exceeds 2³¹ − 1 seconds, is a pause."""
    assert period_ns(rate_hz) == period
    assert rate_of(0) == (0, 1)
