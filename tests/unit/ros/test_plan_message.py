"""The plan of all nodes as a message, and the bounds of its numbers."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import WriterQos
from arpd.model.plan import MOST_GENERATION, TopicPlan
from arpd.ros.documents import pack, unpack
from arpd.ros.names import INFINITE_NS, LEAST_DEADLINE_NS
from arpd.ros.plan_message import MOST_DEPTH, checked_row, decode_plan, encode_plan
from arpd.ros.plan_message import ROW as NAMES
from tests.examples import examples

OWN = WriterQos(depth=10, deadline_ns=0)
ROW = TopicPlan(rate_hz=math.inf, min_rate_hz=1.5, deadline_ns=10**8, depth=20, weight=2.0, wire_bytes=9.5, packets=3)
DATA = encode_plan(generation=MOST_GENERATION, lease_s=30.0, topics={"/t": ROW})


def test_a_plan_is_read_as_it_was_written():
    """All rows, the generation and the lease arrive, an infinite rate too."""
    plan = decode_plan(DATA)
    assert (plan.generation, plan.lease_s) == (MOST_GENERATION, 30.0)
    assert {topic: checked_row(topic, row, OWN) for topic, row in plan.rows.items()} == {"/t": ROW}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("generation", -1),
        ("generation", MOST_GENERATION + 1),
        ("generation", 1.0),
        ("lease_s", -1.0),
        ("lease_s", 4.9),
        ("lease_s", 2e9),
        ("lease_s", None),
        ("rows", []),
    ],
)
def test_a_head_is_within_bounds_or_refused_by_name(name, value):
    """Neither an odd generation, nor a lease shorter than the price is repeated, is taken."""
    with pytest.raises(ValueError, match=name):
        decode_plan(pack({**unpack(DATA, most_bytes=1000), name: value}))


@given(st.binary(max_size=200), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6))
@examples(60)
def test_any_bytes_are_a_plan_or_refused(noise, spoils):
    """Whatever arrives, only ValueError is raised, and only a row of numbers becomes one."""
    data = bytearray(DATA)
    for index, value in spoils:
        data[index % len(data)] = value
    for each in (noise, bytes(data)):
        try:
            plan = decode_plan(each)
            rows = [checked_row(topic, row, OWN) for topic, row in plan.rows.items()]
        except ValueError:
            continue
        assert all(isinstance(row, TopicPlan) for row in rows)


FIELDS = {**{name: getattr(ROW, name) for name in NAMES}, "rate_hz": 50.0, "max_rate_hz": 60.0}
FLOATS, INTEGERS = st.floats(), st.integers(max_value=INFINITE_NS - 1)
BOUNDS = {
    "rate_hz": (FLOATS, lambda value: 0 <= value <= 1e6),
    "min_rate_hz": (FLOATS, lambda value: 0 <= value <= 1e6),
    "weight": (FLOATS, lambda value: value == 0 or 1e-6 <= value <= 1e6),
    "wire_bytes": (FLOATS, lambda value: value == 0 or 1 <= value <= 1e12),
    "depth": (INTEGERS.filter(bool), lambda value: 1 <= value <= MOST_DEPTH),
    "deadline_ns": (INTEGERS, lambda value: value == 0 or value >= LEAST_DEADLINE_NS),
    "packets": (INTEGERS, lambda value: 0 <= value <= 10**9),
    "max_rate_hz": (FLOATS, lambda value: 0 <= value <= 1e6),
}


def checked(row, own=OWN):
    return checked_row("/t", [row[name] for name in NAMES], own)


@pytest.mark.parametrize("field", BOUNDS)
@examples(60)
@given(data=st.data())
def test_a_number_of_a_row_is_within_bounds_or_refused_by_name(field, data):
    """Any number, NaN and denormals too, is taken as it is, or the row is refused by topic and field."""
    numbers, fits = BOUNDS[field]
    value = data.draw(numbers)
    row = {**FIELDS, field: value}
    if fits(value):
        assert checked(row) == TopicPlan(**row)
    else:
        with pytest.raises(ValueError, match=rf"^/t: {field} = '?{re.escape(str(value)[:40])}'? is "):
            checked(row)


def test_the_application_s_own_qos_is_always_allowed():
    """A plan may return to a depth and a deadline beyond the bounds when the application chose them; depth 0 does."""
    own = WriterQos(depth=MOST_DEPTH + 1, deadline_ns=LEAST_DEADLINE_NS - 1)
    row = {**FIELDS, "depth": own.depth, "deadline_ns": own.deadline_ns}
    assert checked(row, own) == checked({**FIELDS, "depth": 0}, own) == TopicPlan(**row)
    with pytest.raises(ValueError, match=r"^/t: d"):
        checked(row)
