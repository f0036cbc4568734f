"""Bounds of the numbers that a plan may have."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.bounds import LEAST_DEADLINE_NS, MOST_DEPTH, MOST_RATE_HZ, check_grant, checked_row
from arpd.adapters.ros.names import INFINITE_NS
from arpd.model.endpoints import WriterQos
from arpd.model.plan import MOST_GENERATION, TopicPlan
from tests.examples import examples

OWN = WriterQos(depth=10, deadline_ns=0)
ROW = {
    "depth": 40,
    "deadline_ns": 10**8,
    "rate_hz": 50.0,
    "min_rate_hz": 1.0,
    "weight": 1.5,
    "wire_bytes": 900.0,
    "packets": 1,
}
FLOATS = {
    "rate_hz": lambda value: 0 <= value <= MOST_RATE_HZ or value == math.inf,
    "min_rate_hz": lambda value: 0 <= value <= MOST_RATE_HZ,
    "weight": lambda value: value == 0 or 1e-6 <= value <= 1e6,
    "wire_bytes": lambda value: value == 0 or 1 <= value <= 1e12,
}
INTEGERS = {
    "depth": lambda value: 1 <= value <= MOST_DEPTH,
    "deadline_ns": lambda value: value == 0 or value >= LEAST_DEADLINE_NS,
    "packets": lambda value: 0 <= value <= 10**9,
}
IN_FORCE = 7


def assert_taken_or_refused(field, value, *, fits):
    """Assert that a row with this value becomes the same plan, or that the refusal names topic and field."""
    row = {**ROW, field: value}
    if fits:
        assert checked_row("/t", row, OWN) == TopicPlan(**row)
    else:
        with pytest.raises(ValueError, match=rf"^/t: {field} = {re.escape(str(value))} is "):
            checked_row("/t", row, OWN)


@pytest.mark.parametrize("field", FLOATS)
@examples(60)
@given(value=st.floats())
def test_a_number_of_a_row_is_within_bounds_or_refused_by_name(field, value):
    """Any float, NaN and denormals too, is taken as it is, or the row is refused by topic and field."""
    assert_taken_or_refused(field, value, fits=FLOATS[field](value))


@pytest.mark.parametrize("field", INTEGERS)
@examples(60)
@given(value=st.integers(max_value=INFINITE_NS - 1))
def test_an_integer_of_a_row_is_within_bounds_or_refused_by_name(field, value):
    """Any integer is taken as it is, or the row is refused by topic and field."""
    assert_taken_or_refused(field, value, fits=INTEGERS[field](value))


def test_the_application_s_own_qos_is_always_allowed():
    """A plan may return to a depth and a deadline beyond the bounds when the application chose them."""
    own = WriterQos(depth=MOST_DEPTH + 1, deadline_ns=LEAST_DEADLINE_NS - 1)
    row = {**ROW, "depth": own.depth, "deadline_ns": own.deadline_ns}
    assert checked_row("/t", row, own) == TopicPlan(**row)
    with pytest.raises(ValueError, match=r"^/t: depth"):
        checked_row("/t", row, OWN)


@pytest.mark.parametrize("value", [INFINITE_NS, 2**64])
def test_an_infinite_deadline_is_none(value):
    """What ROS 2 takes for no deadline, and more, becomes 0."""
    assert checked_row("/t", {**ROW, "deadline_ns": value}, OWN).deadline_ns == 0


@examples(60)
@given(lease_s=st.floats())
def test_a_lease_is_within_bounds_or_refused_by_name(lease_s):
    """Any float is taken, or the plan is refused by the name of its lease."""
    if lease_s == 0 or 5 <= lease_s <= 1e9:
        check_grant(generation=IN_FORCE, lease_s=lease_s, in_force=IN_FORCE)
    else:
        with pytest.raises(ValueError, match=r"^lease_s = .+ is outside"):
            check_grant(generation=IN_FORCE, lease_s=lease_s, in_force=IN_FORCE)


@examples(60)
@given(generation=st.integers())
def test_a_generation_is_neither_older_nor_too_large(generation):
    """Any generation from the one in force to the greatest is taken, another one is refused with its number."""
    if IN_FORCE <= generation <= MOST_GENERATION:
        check_grant(generation=generation, lease_s=0.0, in_force=IN_FORCE)
    else:
        with pytest.raises(ValueError, match=rf"^generation {generation} is "):
            check_grant(generation=generation, lease_s=0.0, in_force=IN_FORCE)
