"""What arpd reads and writes of serialized messages without their classes: pure."""

from __future__ import annotations

import struct

_ORDER = {0: ">", 1: "<"}  # by CDR's representation identifier (OMG DDSI-RTPS 2.3, 10.5)
#: What stands before the bytes of a UInt8MultiArray: an array without dimensions, no offset, and its length.
ARRAY = struct.Struct("<4sIII")
LITTLE_ENDIAN = b"\x00\x01\x00\x00"


def stamp_of(sample: bytes) -> tuple[int, int]:
    """Return the header stamp (s, ns) of a message whose first field is a std_msgs/Header.

    Raises ValueError if the sample is too short.
    """
    try:
        seconds, nanoseconds = struct.unpack_from(_ORDER[sample[1]] + "iI", sample, 4)
    except (KeyError, IndexError, struct.error) as fault:
        raise ValueError("a sample without a header stamp") from fault
    return seconds, nanoseconds


def wrap(content: bytes) -> bytes:
    """Return a serialized UInt8MultiArray with these bytes; rclpy would take an element at a time."""
    return ARRAY.pack(LITTLE_ENDIAN, 0, 0, len(content)) + content


def octets(data: bytes) -> bytes:
    """Return the content of a UInt8MultiArray without dimensions; arpd's have none.

    Raises ValueError if the bytes are no such array.
    """
    size, _order = _head(data)
    held = data[16 : 16 + size]
    if len(held) != size:
        raise ValueError("an array that is cut off")
    return held


def doubles(data: bytes) -> tuple[float, ...]:
    """Return the numbers of a Float64MultiArray without dimensions; errors are those of `octets`."""
    size, order = _head(data)
    if len(data) < 20 + 8 * size:  # the first number is aligned
        raise ValueError("an array that is cut off")
    return struct.unpack_from(f"{order}{size}d", data, 20)


def _head(data: bytes) -> tuple[int, str]:
    """Return the number of items, and the order of bytes."""
    try:
        order = _ORDER[data[1]]
        dimensions, _offset, size = struct.unpack_from(order + "III", data, 4)
    except (KeyError, IndexError, struct.error) as fault:
        raise ValueError("no array of numbers") from fault
    if dimensions:
        raise ValueError("an array with dimensions")
    return size, order
