"""The plan of a node as a message."""

import json
import math

from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.plan_message import decode_plan, encode_plan
from arpd.model.plan import MOST_GENERATION, TopicPlan
from tests.examples import examples

ROW = TopicPlan(rate_hz=math.inf, min_rate_hz=1.5, deadline_ns=10**8, depth=20, weight=2.0, wire_bytes=9.5, packets=3)


def text_of(publishers=None, generation=3, lease_s=30.0):
    return encode_plan(generation=generation, lease_s=lease_s, publishers=publishers or {})


def test_a_plan_is_read_as_it_was_written():
    """All rows, the generation and the lease arrive, an infinite rate too; the text is JSON for any reader."""
    text = text_of({"/t": ROW}, MOST_GENERATION)
    plan = decode_plan(text)
    assert (plan.generation, plan.lease_s) == (MOST_GENERATION, 30.0)
    assert {topic: TopicPlan(**row) for topic, row in plan.publishers.items()} == {"/t": ROW}
    assert json.loads(text)["publishers"]["/t"] == [20, 10**8, None, 1.5, 2.0, 9.5, 3]


def spoilt(**changes):
    return json.dumps({**json.loads(text_of({"/t": ROW})), **changes})


@examples(60)
@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists, max_leaves=8))
def test_any_row_is_read_or_refused(row):
    """Whatever stands for a row, only numbers come out."""
    try:
        plan = decode_plan(spoilt(publishers={"/t": row}))
    except ValueError:
        return
    assert all(isinstance(value, int | float) for value in plan.publishers["/t"].values())
