"""Samples as they cross the link: packed with their writers, and cut into chunks, one to a std_msgs/UInt8MultiArray."""

from __future__ import annotations

import hashlib
import struct
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from arpd.ros.cdr import ARRAY, LITTLE_ENDIAN

if TYPE_CHECKING:
    from collections.abc import Iterable

_CHUNK = struct.Struct("<IIIIIIB")
_WRITER_BYTES = 8
_RECORD = struct.Struct(f"<{_WRITER_BYTES}sIQ")
#: What a chunk adds to the part of the message in it (bytes).
CHUNK_HEADER_BYTES = ARRAY.size + _CHUNK.size
MOST_MESSAGE_BYTES = 2**26
_MOST_BEGUN = 256  # messages of one writer that lack their end: each costs time with every chunk
WRAP = 2**32  # of the numbers and times in a chunk


class Record(NamedTuple):
    """One sample: what stands for its writer, its number there, its bytes."""

    writer: bytes
    sequence: int
    sample: bytes


class Chunk(NamedTuple):
    """A part of a message, as it crosses the link; every field but the part is below `WRAP`.

    Parameters
    ----------
    session : the sender's
    number : counts all chunks of the sender
    departed_us : when it left, by the sender's clock (µs)
    message : number of the first chunk of its message
    offset, total : place of the part, and size of the message (bytes)
    is_kept : whether the message is delivered however old it is
    part : the bytes
    """

    session: int
    number: int
    departed_us: int
    message: int
    offset: int
    total: int
    is_kept: bool
    part: bytes


@lru_cache(maxsize=10_000)
def writer_key(gid: str) -> bytes:
    """Return what stands for the writer with this GUID in records, in a third of its bytes."""
    return hashlib.blake2s(gid.encode(), digest_size=_WRITER_BYTES).digest()


def pack(records: Iterable[Record]) -> bytes:
    """Return one message with these records."""
    return b"".join(
        part for writer, sequence, sample in records for part in (_RECORD.pack(writer, len(sample), sequence), sample)
    )


def unpack(message: bytes) -> list[Record]:
    """Return the records of a message, or of several in a row; raises ValueError if `pack` returns no such bytes."""
    records, at = [], 0
    while at < len(message):
        if at + _RECORD.size > len(message):
            raise ValueError("no samples of a relay")
        writer, size, sequence = _RECORD.unpack_from(message, at)
        at += _RECORD.size + size
        if at > len(message):
            raise ValueError("the last sample of a relay is cut off")
        records.append(Record(writer, sequence, message[at - size : at]))
    return records


def encode_chunk(chunk: Chunk) -> bytes:
    """Return a serialized UInt8MultiArray with a chunk."""
    size = _CHUNK.size + len(chunk.part)
    return ARRAY.pack(LITTLE_ENDIAN, 0, 0, size) + _CHUNK.pack(*chunk[:7]) + chunk.part


def decode_chunk(sample: bytes) -> Chunk:
    """Return the chunk in a serialized UInt8MultiArray; raises ValueError if it holds none."""
    try:
        cdr, dimensions, offset, size = ARRAY.unpack_from(sample)
        session, number, departed_us, message, at, total, is_kept = _CHUNK.unpack_from(sample, ARRAY.size)
    except struct.error as fault:
        raise ValueError("no chunk of a relay") from fault
    part = sample[CHUNK_HEADER_BYTES : ARRAY.size + size]
    chunk = Chunk(session, number, departed_us, message, at, total, bool(is_kept), part)
    if cdr[:2] != LITTLE_ENDIAN[:2] or dimensions or offset or len(part) != size - _CHUNK.size:
        raise ValueError("no chunk of a relay")
    if not chunk.offset + len(part) <= chunk.total <= MOST_MESSAGE_BYTES:
        raise ValueError(f"a chunk at {chunk.offset} of a message of {chunk.total} bytes")
    return chunk


class Assembly:
    """Puts the chunks of one writer on the link together: a message is whole, or it is not delivered.

    The chunks of each message come in their order; a lost one ends its message. Those of several topics come by turns.
    Where more than the largest message lacks its end, or 256 do, what waited longest for a chunk gives way.
    """

    def __init__(self) -> None:
        self._ended = (-1, -1)
        self._begun: dict[tuple[int, int], bytearray] = {}

    def add(self, chunk: Chunk) -> bytes | None:
        """Return the message that this chunk completes, None before its end."""
        if self._ended == (key := (chunk.session, chunk.message)):
            return None  # doubled
        if chunk.offset == 0:  # another one of its writer will never end
            writer = chunk.part[:_WRITER_BYTES]
            self._begun = {each: part for each, part in self._begun.items() if part[:_WRITER_BYTES] != writer}
            self._begun[key] = bytearray()
        begun = self._begun.pop(key, None)
        if begun is None or len(begun) != chunk.offset:
            return None
        begun += chunk.part
        if len(begun) == chunk.total:
            self._ended = key
            return bytes(begun)
        self._begun[key] = begun
        while len(self._begun) > _MOST_BEGUN or sum(map(len, self._begun.values())) > MOST_MESSAGE_BYTES:
            del self._begun[next(iter(self._begun))]
        return None
