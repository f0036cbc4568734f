"""The plan of all nodes as a message."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import WriterQos
from arpd.model.plan import MOST_GENERATION, TopicPlan
from arpd.ros.bounds import checked_row
from arpd.ros.documents import pack, unpack
from arpd.ros.plan_message import decode_plan, encode_plan
from tests.examples import examples

OWN = WriterQos(depth=10, deadline_ns=0)
ROW = TopicPlan(rate_hz=math.inf, min_rate_hz=1.5, deadline_ns=10**8, depth=20, weight=2.0, wire_bytes=9.5, packets=3)
DATA = encode_plan(generation=MOST_GENERATION, lease_s=30.0, topics={"/t": ROW})


def test_a_plan_is_read_as_it_was_written():
    """All rows, the generation and the lease arrive, an infinite rate too."""
    plan = decode_plan(DATA)
    assert (plan.generation, plan.lease_s) == (MOST_GENERATION, 30.0)
    assert {topic: checked_row(topic, row, OWN) for topic, row in plan.rows.items()} == {"/t": ROW}


def spoilt(**changes):
    return pack({**unpack(DATA, most_bytes=1000), **changes})


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
        decode_plan(spoilt(**{name: value}))


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
