"""The numbers that a node tells once a second."""

import math
import struct
from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.ros.counters import (
    MOST_COUNTERS_BYTES,
    NUMBERS,
    decode_counters,
    encode_counters,
    row_of,
    sender_of,
)
from arpd.adapters.ros.plan_message import PlanAnswer
from arpd.model.endpoints import WithheldCause
from arpd.observe.registry import MOST_OF_NODE
from tests.sample_publishers import publisher

TOLD = publisher("/n", "/t", offered=1000, published=900, withheld=3, withheld_by_cause={"price": 3}, rate_hz=20.0)
BUSY = replace(
    TOLD,
    offered=1020,
    published=915,
    withheld=8,
    withheld_by_cause={"price": 8},
    source_rate_hz=20.5,
    published_rate_hz=15.25,
    paced_rate_hz=15.0,
    blocked_s=0.125,
)
ANSWER = PlanAnswer(generation=2**53, crc=2**32 - 1, refusal="")


def message(*rows, answer=ANSWER, lease_s=30.0):
    return encode_counters("/n", rows, incarnation=2**64 - 1, answer=answer, lease_s=lease_s)


def fields_of(state):
    return {field.name: getattr(state, field.name) for field in fields(state)}


def told_again(told, now):
    """Return the state that a daemon makes of a status and the row that follows."""
    (row,) = decode_counters(message(row_of(4, 255, told=told, now=now))).rows
    assert (row.number, row.serial) == (4, 255)
    return replace(told, **row.changes(fields_of(told)))


def test_a_state_is_read_as_it_was_told():
    """A status and the numbers after it make the state that the publisher has."""
    assert told_again(TOLD, BUSY) == BUSY
    assert told_again(TOLD, TOLD) == TOLD
    unpaced = replace(TOLD, rate_hz=math.inf, paced_rate_hz=math.inf, source_rate_hz=0.0, queued=7, deadlines_missed=2)
    assert told_again(replace(BUSY, queued=3), unpaced).rate_hz == math.inf
    assert told_again(TOLD, unpaced) == unpaced


@settings(max_examples=100)
@given(
    st.integers(0, 2**40),
    st.integers(0, 2**31),
    st.dictionaries(st.sampled_from([cause.value for cause in WithheldCause]), st.integers(1, 2**20)),
    st.floats(0, 1e5, width=32),
)
def test_every_change_arrives(start, more, causes, rate_hz):
    """Whatever grows between two statuses has grown by as much at the daemon."""
    told = replace(TOLD, offered=start, published=start)
    by_cause = {**causes, "price": 3 + causes.get("price", 0)}
    now = replace(
        told,
        offered=start + more,
        published=start + more,
        withheld=sum(by_cause.values()),
        withheld_by_cause=by_cause,
        source_rate_hz=rate_hz,
    )
    assert told_again(told, now) == now


def test_a_busy_topic_takes_forty_bytes_a_second():
    """A topic whose rates, counts and blocked time all change takes at most 43 bytes, and a silent one 7."""
    assert len(row_of(1, 2, told=TOLD, now=BUSY)) <= 43
    assert len(row_of(1, 2, told=TOLD, now=TOLD)) == 7


def test_the_greatest_honest_message_is_not_refused_for_its_size():
    """As many publishers as a node may have, with all numbers changed, fit into a message."""
    changed = replace(
        BUSY,
        rate_hz=1.0,
        payload_bytes=1.0,
        queued=4,
        deadlines_missed=9,
        withheld_by_cause={cause.value: 99 for cause in WithheldCause},
    )
    row = row_of(1, 2, told=TOLD, now=changed)
    assert len(message(*[row] * MOST_OF_NODE, answer=PlanAnswer(1, 2, "é" * 300))) < MOST_COUNTERS_BYTES - 100


def test_the_head_names_the_node_and_its_answer():
    """Name, incarnation, answer and lease arrive; control characters of a refusal do not."""
    data = message(answer=PlanAnswer(generation=3, crc=9, refusal="no\x1b[2J"))
    found = decode_counters(data)
    assert (found.node, sender_of(data), found.incarnation, found.lease_s) == ("/n", "/n", 2**64 - 1, 30.0)
    assert found.answer == (3, 9, "no?[2J")
    assert not found.rows


@pytest.mark.parametrize(
    "data",
    [
        b"",
        message()[:-1],
        message() + b"\0",
        message(row_of(1, 2, told=TOLD, now=BUSY))[:-1],
        b"\xff" + message()[1:],
        message(lease_s=math.nan),
        message(lease_s=1e10),
        message(answer=PlanAnswer(2**53 + 1, 0, "")),
        encode_counters("no name", [], incarnation=1, answer=ANSWER, lease_s=0.0),
    ],
)
def test_nonsense_is_refused(data):
    """A message that is cut off, too long, of another version or with impossible values is refused."""
    with pytest.raises(ValueError, match="counters"):
        decode_counters(data)


@pytest.mark.parametrize("value", [math.nan, -1.0, math.inf, 1e10])
@pytest.mark.parametrize("bit", [9, 10, 13, 14])
def test_an_impossible_rate_or_size_is_refused(bit, value):
    """No rate of a source, size or blocked time is negative, without end or not a number."""
    with pytest.raises(ValueError, match="which is not from 0"):
        decode_counters(message(struct.pack("<IBHf", 1, 0, 1 << bit, value)))


def test_a_mask_with_an_unknown_number_is_refused():
    """A bit that means nothing makes the row shorter than its sender meant."""
    with pytest.raises(ValueError, match="counters"):
        decode_counters(message(struct.pack("<IBHf", 1, 0, 1 << 15, 1.0)))


def test_every_number_that_a_row_has_is_a_field():
    """What the announcer leaves to the numbers is what a row can tell."""
    row = decode_counters(message(struct.pack("<IBH9I6f", 1, 0, 0x7FFF, *[1] * 9, *[1.0] * 6))).rows[0]
    changed = row.changes(fields_of(TOLD))
    assert changed.keys() == NUMBERS


def test_a_rate_beyond_a_float_of_32_bits_is_endless():
    """A price from the network may give any rate; the row is still made."""
    assert told_again(TOLD, replace(TOLD, paced_rate_hz=1e303)) == replace(TOLD, paced_rate_hz=math.inf)


def test_numbers_that_no_daemon_believes_are_cut():
    """A source of a million hertz silences nobody else of its node."""
    fast = replace(TOLD, source_rate_hz=1e6, payload_bytes=2.0**40)
    assert told_again(TOLD, fast) == replace(TOLD, source_rate_hz=1e5, payload_bytes=2.0**30)
