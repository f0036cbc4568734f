"""The plan of a node as a message."""

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.ros.plan_message import decode_plan, encode_plan
from arpd.model.plan import MOST_GENERATION, ReaderPlan, TopicPlan

ROW = TopicPlan(rate_hz=math.inf, min_rate_hz=1.5, deadline_ns=10**8, depth=20, weight=2.0, wire_bytes=9.5, packets=3)
READ = ReaderPlan(depth=7, deadline_ns=0)


def text_of(publishers=None, readers=None, generation=3, lease_s=30.0):
    return encode_plan(generation=generation, lease_s=lease_s, publishers=publishers or {}, readers=readers or {})


def test_a_plan_is_read_as_it_was_written():
    """All rows, the generation and the lease arrive, an infinite rate too; the text is JSON for any reader."""
    text = text_of({"/t": ROW}, {"/r": READ}, MOST_GENERATION)
    plan = decode_plan(text)
    assert (plan.generation, plan.lease_s) == (MOST_GENERATION, 30.0)
    assert {topic: TopicPlan(**row) for topic, row in plan.publishers.items()} == {"/t": ROW}
    assert {topic: ReaderPlan(**row) for topic, row in plan.readers.items()} == {"/r": READ}
    assert json.loads(text)["publishers"]["/t"] == [20, 10**8, None, 1.5, 2.0, 9.5, 3]


def test_the_order_of_the_rows_does_not_change_the_text():
    """Nodes answer by the hash of the text, so the same plan has the same one."""
    assert text_of({"/a": ROW, "/b": ROW}) == text_of({"/b": ROW, "/a": ROW})


def test_a_row_takes_about_a_hundred_bytes():
    """A plan for 250 topics is smaller than one UDP datagram."""
    rows = {f"/robot/sensors/camera_{number}/image": ROW for number in range(250)}
    assert len(text_of(rows)) < 250 * 100


def spoilt(**changes):
    return json.dumps({**json.loads(text_of({"/t": ROW}, {"/r": READ})), **changes})


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "7",
        "[" * 100_000,
        "x" * 2_000_000,
        spoilt(version=2),
        spoilt(version=None),
        spoilt(generation=-1),
        spoilt(generation=MOST_GENERATION + 1),
        spoilt(generation=1.5),
        spoilt(generation=True),
        spoilt(generation=None),
        spoilt(lease_s="long"),
        spoilt(lease_s=None),
        spoilt(lease_s=math.nan),
        spoilt(lease_s=10**400),
        spoilt(publishers=[]),
        spoilt(readers=None),
        spoilt(publishers={"no name": [1, 0, 1.0, 1.0, 1.0, 1.0, 1]}),
        spoilt(publishers={"/t": [1, 0, 1.0, 1.0, 1.0, 1.0]}),
        spoilt(publishers={"/t": 5}),
        spoilt(publishers={"/t": [1, None, 1.0, 1.0, 1.0, 1.0, 1]}),
        spoilt(publishers={"/t": [1.5, 0, 1.0, 1.0, 1.0, 1.0, 1]}),
        spoilt(publishers={"/t": [1, 0, 1.0, None, 1.0, 1.0, 1]}),
        spoilt(publishers={"/t": [1, 0, False, 1.0, 1.0, 1.0, 1]}),
        spoilt(publishers={"/t": [1, 0, math.inf, 1.0, 1.0, 1.0, 1]}),
        spoilt(readers={"/r": [1, "0"]}),
    ],
    ids=str,
)
def test_what_is_no_plan_is_refused(text):
    """A text that is no JSON, of another version, or with other values than numbers is refused in short words."""
    with pytest.raises(ValueError, match=r"plan|JSON") as refusal:
        decode_plan(text)
    assert len(str(refusal.value)) < 300


@settings(max_examples=60)
@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists, max_leaves=8))
def test_any_row_is_read_or_refused(row):
    """Whatever stands for a row, only numbers come out."""
    try:
        plan = decode_plan(spoilt(publishers={"/t": row}))
    except ValueError:
        return
    assert all(isinstance(value, int | float) for value in plan.publishers["/t"].values())
