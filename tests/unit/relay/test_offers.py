"""States that the ends of a relay tell each other."""

import zlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from arpd.relay.ends import offers
from arpd.relay.ends.offers import (
    EndState,
    TopicOffer,
    WriterOffer,
    decode_state,
    encode_state,
)
from arpd.ros.documents import pack, unpack

STATE = EndState(
    session=7,
    topics={"/a": TopicOffer(type_name="t", writers=(WriterOffer(node="/n", gid="00"),), link_name="/a")},
)


@given(st.binary(max_size=200))
@example(b'{"topics":' + b"[" * 100_000)
def test_bytes_that_are_no_state_are_refused(data):
    """Bytes of another origin are refused, compressed or not, and brackets by the hundred thousand."""
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
    monkeypatch.setattr(offers, "VERSION", 99)
    data = encode_state(EndState(session=7, arpd="9.9"))
    monkeypatch.undo()
    with pytest.raises(ValueError, match=rf"version 99 \(arpd 9.9\), this end version {offers.VERSION}"):
        decode_state(data)


def test_a_state_of_another_robot_is_refused():
    """Two robots in one link domain differ by their namespaces; the fault names both."""
    data = encode_state(EndState(session=7, namespace="/spot"))
    assert decode_state(data, namespace="/spot").session == 7
    with pytest.raises(ValueError, match=r"relay\.namespace '/spot', and this end '/rosie'; .* relay\.link_domain"):
        decode_state(data, namespace="/rosie")
