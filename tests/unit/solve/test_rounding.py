"""Exact numbers: what a person reads, whole units, and periods that never run faster than the rate."""

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
    """Whole multiples of the common part are the values again."""
    numbers, scale = whole([value.as_integer_ratio() for value in values])
    assert [Fraction(number, scale) for number in numbers] == values


@given(RATES)
def test_a_period_is_the_shortest_whole_one_that_is_not_faster(rate_hz):
    """One nanosecond less would be faster than the rate."""
    period = period_ns(rate_hz.as_integer_ratio())
    assert Fraction(*rate_of(period)) <= rate_hz
    assert period == 1 or Fraction(10**9, period - 1) > rate_hz


@pytest.mark.parametrize("rate_hz", [(0, 1), (1, 2**31), (1, 10**30)])
def test_what_dds_cannot_say_is_a_pause(rate_hz):
    """No rate, or one whose period is longer than a DDS duration, is paused."""
    assert period_ns(rate_hz) == 0
    assert rate_of(0) == (0, 1)


def test_the_longest_period_dds_can_say_is_no_pause():
    """2³¹ − 1 seconds still is a period."""
    assert period_ns((1, 2**31 - 1)) == (2**31 - 1) * 10**9
