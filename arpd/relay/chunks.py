"""Messages cross the link in chunks between the two ends, which confirm what has arrived: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.endpoint.queue import Part
from arpd.model.wire import FRAGMENT_BYTES, wire_size
from arpd.relay.envelope import (
    CHUNK_HEADER_BYTES,
    MOST_MESSAGE_BYTES,
    PASSENGER_BYTES,
    WRAP,
    Chunk,
    encode_chunk,
    join,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.endpoint.lane import Lane, UnderWay
    from arpd.relay.flight import Flight

_CHUNK_S = 0.0025  # of the link; samples of one packet wait behind one chunk
_LEAST_PACKETS, _MOST_PACKETS = 2, 16
_UNKNOWN_PACKETS = 4
_COMPANY_PACKETS, _COMPANY_S = 2.0, 0.005  # small messages wait for others: so many packets' time, at most so long


class Chunks:
    """Cuts large messages, so that small ones wait behind one chunk at most; a `Carrier` of the paced queue.

    Parameters
    ----------
    session : of this process, 32 bit
    flight : what is on its way
    """

    most_bytes: float = MOST_MESSAGE_BYTES
    has_receipts = True
    seat_bytes = PASSENGER_BYTES
    together_bytes = FRAGMENT_BYTES - CHUNK_HEADER_BYTES

    def __init__(self, session: int, flight: Flight) -> None:
        self._session = session
        self._flight = flight
        self.company_s = 0.0
        self.adapt(None)
        self.has_room, self.is_out = flight.has_room, flight.is_out

    @property
    def relief(self) -> float:
        """Times its share that the queue drains: less than once while a queue stands on the link."""
        return self._flight.relief

    def adapt(self, capacity: float | None) -> None:
        """Let a chunk take its time of the link; None = no daemon is heard (bytes/s)."""
        self._flight.capacity = capacity
        packets = _UNKNOWN_PACKETS if capacity is None else round(_CHUNK_S * capacity / FRAGMENT_BYTES)
        self._chunk_bytes = self._bytes_of(packets)
        self.company_s = min(_COMPANY_S, _COMPANY_PACKETS * FRAGMENT_BYTES / (capacity or math.inf))

    def cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_whole: bool, asking_bytes: float) -> Part:
        """Return the next chunk of a message, or one with all of it."""
        message, offset = current.message, current.offset
        most = len(message) if is_whole else self._chunk_bytes
        part = message[offset : offset + most] if most < len(message) else message
        number, size, packets = self._send(part, now_s, asking_bytes)
        if offset == 0:
            current.number = number
        current.offset += len(part)
        departed_us = int(now_s * 1e6) % WRAP
        chunk = Chunk(self._session, number, departed_us, current.number, offset, len(message), lane.is_kept, part)
        return Part(encode_chunk(chunk), size, packets)

    def join(self, messages: Sequence[tuple[bytes, bytes]], now_s: float, *, asking_bytes: float) -> Part:
        """Return one chunk with the keys and messages of several topics."""
        part = join(messages)
        number, size, packets = self._send(part, now_s, asking_bytes)
        departed_us = int(now_s * 1e6) % WRAP
        chunk = Chunk(self._session, number, departed_us, number, 0, len(part), is_kept=False, part=part)
        return Part(encode_chunk(chunk), size, packets)

    def _send(self, part: bytes, now_s: float, asking_bytes: float) -> tuple[int, float, int]:
        """Count a chunk as sent; return its number, and the bytes and packets that it takes of the link."""
        size, packets = wire_size(len(part) + CHUNK_HEADER_BYTES, rate_hz=math.inf)
        size += asking_bytes
        return self._flight.send(int(size), now_s), size, packets

    @staticmethod
    def _bytes_of(packets: int) -> int:
        return min(max(packets, _LEAST_PACKETS), _MOST_PACKETS) * FRAGMENT_BYTES - CHUNK_HEADER_BYTES
