"""Messages from the network: read without decoding."""

import math
from contextlib import suppress

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.ros.raw_reader import doubles, octets
from tests.examples import examples

VALUES = [1.0, -math.inf, 2.5]
NUMBERS = serialize_message(Float64MultiArray(data=VALUES))
MESSAGE = serialize_message(UInt8MultiArray(data=bytes(range(40))))


@given(st.binary(max_size=60), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), max_size=6), st.data())
@examples(50)
def test_any_bytes_are_refused_or_read(noise, spoils, data):
    """Any bytes are refused or read, and nothing else is raised."""
    assert octets(MESSAGE) == bytes(range(40))
    assert list(doubles(NUMBERS)) == VALUES
    for message, read in ((MESSAGE, octets), (NUMBERS, doubles)):
        spoilt = bytearray(message[: data.draw(st.integers(0, len(message)))])
        for index, value in spoils:
            if spoilt:
                spoilt[index % len(spoilt)] = value
        for each in (noise, bytes(spoilt)):
            with suppress(ValueError):
                read(each)
