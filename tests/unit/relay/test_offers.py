"""States that the ends of a relay tell each other."""

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.relay.ends import offers
from arpd.relay.ends.offers import (
    EndState,
    ServiceOffer,
    TopicOffer,
    WriterOffer,
    decode_state,
    encode_state,
)
from arpd.ros.documents import pack, unpack

NAMES = st.text(min_size=1, max_size=20)
PERIODS = st.integers(0, 2**63 - 1)
WRITERS = st.builds(
    WriterOffer,
    node=NAMES,
    gid=st.binary(min_size=16, max_size=16).map(bytes.hex),
    is_reliable=st.booleans(),
    is_latched=st.booleans(),
    deadline_ns=PERIODS,
    lifespan_ns=PERIODS,
    lease_ns=PERIODS,
    is_manual=st.booleans(),
    is_alive=st.booleans(),
)
TOPICS = st.builds(
    TopicOffer,
    type_name=NAMES,
    writers=st.lists(WRITERS, max_size=3).map(tuple),
    link_name=st.from_regex(r"/[a-z]{1,9}", fullmatch=True),
    type_hash=NAMES,
    planned_depth=st.integers(0, 5000),
    planned_deadline_ns=PERIODS,
)
STATES = st.builds(
    EndState,
    session=st.integers(1, 2**32 - 1),
    host=NAMES,
    arpd=NAMES,
    topics=st.dictionaries(NAMES, TOPICS, max_size=3),
    services=st.dictionaries(NAMES, st.builds(ServiceOffer, type_name=NAMES, node=NAMES), max_size=3),
    wants=st.frozensets(NAMES, max_size=3),
    refused=st.dictionaries(NAMES, NAMES, max_size=3),
)
STATE = EndState(
    session=7,
    topics={"/a": TopicOffer(type_name="t", writers=(WriterOffer(node="/n", gid="00"),), link_name="/a")},
)


@given(STATES)
def test_a_state_arrives_as_it_was_sent(state):
    """Whatever an end tells, the other one reads the same."""
    assert decode_state(encode_state(state)) == state


@given(st.binary(max_size=200))
def test_bytes_that_are_no_state_are_refused(data):
    """Bytes of another origin are refused, compressed or not."""
    for each in (data, zlib.compress(data)):
        with pytest.raises(ValueError):
            decode_state(each)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("session",), 0),
        (("topics", "/a", "writers", 0, "deadline_ns"), -1),
        (("topics", "/a", "planned_depth"), 5001),
        (("topics", "/a", "writers"), 7),
        (("topics", "/a", "link_name"), "/no name"),
        (("topics", "/a", "link_name"), "/" + 247 * "a"),  # ROS takes no more than 247 characters
        (("services",), {"/s": {"type_name": "t"}}),
    ],
)
def test_a_state_with_a_bad_value_is_refused(path, value):
    """A value of the wrong kind, or out of range, spoils the whole state."""
    document = unpack(encode_state(STATE), most_bytes=10_000)
    held = document
    for step in path[:-1]:
        held = held[step]
    held[path[-1]] = value
    with pytest.raises(ValueError):
        decode_state(pack(document))


def test_a_state_of_another_version_says_so(monkeypatch):
    """The versions of both ends are in the fault."""
    monkeypatch.setattr(offers, "VERSION", 9)
    data = encode_state(EndState(session=7, arpd="9.9"))
    monkeypatch.undo()
    with pytest.raises(ValueError, match=rf"version 9 \(arpd 9.9\), this end version {offers.VERSION}"):
        decode_state(data)


def test_a_state_that_is_nested_without_end_is_refused():
    """Brackets by the hundred thousand are no state, and end nothing."""
    with pytest.raises(ValueError, match="recursion"):
        decode_state(b'{"topics":' + b"[" * 100_000)
