"""Samples as they cross the link."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.relay.envelope import Record, pack, source_of, stamp_of, unpack, wrap

RECORDS = st.lists(
    st.builds(
        Record,
        st.integers(0, 2**16 - 1),
        st.integers(0, 2**16 - 1),
        st.integers(0, 2**64 - 1),
        st.binary(max_size=300),
    ),
    min_size=1,
    max_size=4,
)


@given(st.integers(0, 2**32 - 1), RECORDS)
def test_records_arrive_as_they_were_packed(session, records):
    """Session, members, writers, numbers and samples survive."""
    assert unpack(pack(session, records)) == (session, records)


@given(st.integers(0, 2**32 - 1), RECORDS, st.data())
def test_a_message_that_is_cut_off_is_refused(session, records, data):
    """No prefix of a message is taken for one."""
    message = pack(session, records)
    cut = data.draw(st.integers(0, len(message) - 1))
    with pytest.raises(ValueError, match="relay"):
        unpack(message[:cut])


@given(st.binary(max_size=100))
def test_other_bytes_are_refused(message):
    """Bytes of another origin are no samples of a relay."""
    with pytest.raises(ValueError, match="relay"):
        unpack(b"\x00\x00" + message)


def test_the_source_is_the_writer_of_the_first_record():
    """Two samples have one source if the same writer gave them."""
    first, second, third = (pack(5, [Record(0, writer, k, b"x")]) for k, writer in enumerate((7, 7, 8)))
    assert source_of(first) == source_of(second) != source_of(third)


@pytest.mark.parametrize("order", ["<", ">"])
def test_the_stamp_is_read_in_either_byte_order(order):
    """The stamp of a serialized header is seconds and nanoseconds, in the byte order that the sample names."""
    sample = bytes([0, order == "<", 0, 0]) + struct.pack(order + "iI", 12, 34) + b"rest"
    assert stamp_of(sample) == (12, 34)


@pytest.mark.parametrize("sample", [b"", b"\0\1\0\0", b"\0\7\0\0" + bytes(8)])
def test_a_sample_without_a_stamp_is_refused(sample):
    """Too short a sample, or one in another encoding, has no stamp."""
    with pytest.raises(ValueError, match="stamp"):
        stamp_of(sample)


def test_wrapped_bytes_are_a_message_of_ros():
    """What is wrapped is a serialized UInt8MultiArray."""
    rclpy = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    from std_msgs.msg import UInt8MultiArray

    assert bytes(rclpy.deserialize_message(wrap(b"abc"), UInt8MultiArray).data) == b"abc"
