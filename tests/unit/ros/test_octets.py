"""Messages from the network: read without decoding."""

from contextlib import suppress

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

from arpd.ros.raw_reader import octets
from tests.examples import examples

MESSAGE = serialize_message(UInt8MultiArray(data=bytes(range(40))))


@given(st.binary(max_size=60), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6), st.data())
@examples(50)
def test_any_bytes_are_refused_or_read(noise, spoils, data):
    """Any bytes are refused or read, and nothing else is raised."""
    assert octets(MESSAGE) == bytes(range(40))
    spoilt = bytearray(MESSAGE[: data.draw(st.integers(0, len(MESSAGE)))])
    for index, value in spoils:
        if spoilt:
            spoilt[index % len(spoilt)] = value
    for each in (noise, bytes(spoilt)):
        with suppress(ValueError):
            octets(each)
