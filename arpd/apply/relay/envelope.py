"""Samples as they cross the link: one or several of them, with their writers, in a std_msgs/UInt8MultiArray."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable

# CDR, little endian: an array without dimensions, no offset, and its length (OMG DDSI-RTPS 2.3, 10.5).
_MESSAGE = struct.Struct("<4sIII")
_CDR = b"\x00\x01\x00\x00"
_SESSION = struct.Struct("<I")
_RECORD = struct.Struct("<HHIQ")
_WRITER = slice(_MESSAGE.size + _SESSION.size, _MESSAGE.size + _SESSION.size + 4)
_ORDER = {0: ">", 1: "<"}


class Record(NamedTuple):
    """One sample: the place of its topic in a group, the number of its writer, its own number there, its bytes."""

    member: int
    writer: int
    sequence: int
    sample: bytes


def pack(session: int, records: Iterable[Record]) -> bytes:
    """Return a serialized UInt8MultiArray with these records.

    Parameters
    ----------
    session : the sender's, 32 bit: writers have other numbers in another session
    """
    parts = [b"", _SESSION.pack(session)]
    for member, writer, sequence, sample in records:
        parts += _RECORD.pack(member, writer, len(sample), sequence), sample
    parts[0] = _MESSAGE.pack(_CDR, 0, 0, sum(map(len, parts)))
    return b"".join(parts)


def wrap(data: bytes) -> bytes:
    """Return a serialized UInt8MultiArray with these bytes."""
    return _MESSAGE.pack(_CDR, 0, 0, len(data)) + data


def unpack(message: bytes) -> tuple[int, list[Record]]:
    """Return the session and the records of a serialized UInt8MultiArray.

    Raises
    ------
    ValueError
        If the bytes are none that `pack` returns.
    """
    try:
        cdr, dimensions, offset, size = _MESSAGE.unpack_from(message)
        (session,) = _SESSION.unpack_from(message, _MESSAGE.size)
        at, end = _MESSAGE.size + _SESSION.size, _MESSAGE.size + size
        if cdr[:2] != _CDR[:2] or dimensions or offset or end > len(message):
            raise ValueError("no samples of a relay")
        records = []
        while at < end:
            member, writer, length, sequence = _RECORD.unpack_from(message, at)
            at += _RECORD.size
            if at + length > end:
                raise ValueError("a sample of a relay is cut off")
            records.append(Record(member, writer, sequence, message[at : at + length]))
            at += length
    except struct.error as fault:
        raise ValueError("no samples of a relay") from fault
    return session, records


def source_of(message: bytes) -> bytes:
    """Return what names the writer of a packed sample; pacing keeps the newest sample of each."""
    return message[_WRITER]


def stamp_of(sample: bytes) -> tuple[int, int]:
    """Return the header stamp (s, ns) of a serialized message whose first field is a std_msgs/Header.

    Raises
    ------
    ValueError
        If the sample is too short.
    """
    try:
        seconds, nanoseconds = struct.unpack_from(_ORDER[sample[1]] + "iI", sample, 4)
    except (KeyError, IndexError, struct.error) as fault:
        raise ValueError("a sample without a header stamp") from fault
    return seconds, nanoseconds
