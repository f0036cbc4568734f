"""Bounds of the numbers that a plan may have."""

import math
import re
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import WriterQos
from arpd.model.plan import TopicPlan
from arpd.ros.bounds import LEAST_DEADLINE_NS, MOST_DEPTH, ROW_FIELDS, checked_row
from arpd.ros.names import INFINITE_NS
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
FLOATS, INTEGERS = st.floats(), st.integers(max_value=INFINITE_NS - 1)
FIELDS = {
    "rate_hz": (FLOATS, lambda value: 0 <= value <= 1e6),
    "min_rate_hz": (FLOATS, lambda value: 0 <= value <= 1e6),
    "weight": (FLOATS, lambda value: value == 0 or 1e-6 <= value <= 1e6),
    "wire_bytes": (FLOATS, lambda value: value == 0 or 1 <= value <= 1e12),
    "depth": (INTEGERS, lambda value: 1 <= value <= MOST_DEPTH),
    "deadline_ns": (INTEGERS, lambda value: value == 0 or value >= LEAST_DEADLINE_NS),
    "packets": (INTEGERS, lambda value: 0 <= value <= 10**9),
}


def checked(row, own=OWN):
    return checked_row("/t", [row[name] for name in ROW_FIELDS], own)


@pytest.mark.parametrize("field", FIELDS)
@examples(60)
@given(data=st.data())
def test_a_number_of_a_row_is_within_bounds_or_refused_by_name(field, data):
    """Any number, NaN and denormals too, is taken as it is, or the row is refused by topic and field."""
    numbers, fits = FIELDS[field]
    value = data.draw(numbers)
    row = {**ROW, field: value}
    if fits(value):
        assert checked(row) == TopicPlan(**row)
    else:
        with pytest.raises(ValueError, match=rf"^/t: {field} = '?{re.escape(str(value)[:40])}'? is "):
            checked(row)


def test_the_application_s_own_qos_is_always_allowed():
    """A plan may return to a depth and a deadline beyond the bounds when the application chose them."""
    own = WriterQos(depth=MOST_DEPTH + 1, deadline_ns=LEAST_DEADLINE_NS - 1)
    row = {**ROW, "depth": own.depth, "deadline_ns": own.deadline_ns}
    assert checked(row, own) == TopicPlan(**row)
    with pytest.raises(ValueError, match=r"^/t: d"):
        checked(row)


def test_what_is_infinite_is_read_as_such():
    """No rate is an infinite one, and what ROS 2 takes for no deadline becomes 0."""
    row = checked({**ROW, "rate_hz": None, "deadline_ns": INFINITE_NS})
    assert (row.rate_hz, row.deadline_ns) == (math.inf, 0)


@examples(60)
@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists, max_leaves=8))
def test_any_row_is_read_or_refused(row):
    """Whatever stands for a row, only a plan comes out."""
    with suppress(ValueError):
        assert isinstance(checked_row("/t", row, OWN), TopicPlan)
