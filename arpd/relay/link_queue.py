"""The paced queue of an end: messages cross in chunks, and the other end confirms what has arrived. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.endpoint.queue import LEAST_SHARE, MOST_SHARE, SOON_S, PacedQueue, Part, Ready
from arpd.model.endpoints import WithheldCause
from arpd.model.wire import FRAGMENT_BYTES, HEARTBEAT_S, QUICK_HEARTBEAT_S, wire_size
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
    from collections.abc import Hashable

    from arpd.endpoint.lane import Lane, UnderWay
    from arpd.relay.flight import Flight

_CHUNK_S = 0.0025  # of the link; samples of one packet wait behind one chunk
_LEAST_PACKETS, _MOST_PACKETS = 2, 16
_UNKNOWN_PACKETS = 4
_COMPANY_PACKETS, _COMPANY_S = 2.0, 0.005  # small messages wait for others: so many packets' time, at most so long
_TOGETHER_BYTES = FRAGMENT_BYTES - CHUNK_HEADER_BYTES


class LinkQueue(PacedQueue):
    """Cuts large messages into chunks, so that small ones wait behind one chunk at most.

    A message under way is finished before the next one of its topic. The queue drains at the share of the link that its
    topics' rates take at the price, and what no topic of any process takes; what is left serves small topics beyond
    their rate, too. Without a daemon only what is on its way bounds it.

    Small messages of several topics leave together in one packet: of a sample of 300 bytes its own packet, heartbeat
    and acknowledgement would be the larger part. Those that come within the time of two packets wait for each other; a
    message that comes after a pause waits for none.

    Parameters
    ----------
    session : of this process, 32 bit
    flight : what is on its way
    coach : lane of the writer of messages that leave together; None = each leaves alone
    """

    def __init__(self, session: int, flight: Flight, coach: Lane | None = None) -> None:
        super().__init__()
        self._session = session
        self._flight = flight
        self._coach = coach
        self._departs_s = -math.inf  # when the next messages leave together
        self._share = math.inf  # link time a second, may be spent
        self._was_out = False
        self._adapt(None)

    def offer(
        self, lane: Lane, message: bytes, now_s: float, *, source: Hashable = None, expires_s: float = math.inf
    ) -> None:
        """Let a message wait for its turn; `Lane.offer` explains the arguments."""
        if len(message) > MOST_MESSAGE_BYTES:
            lane.offered_rate.count(now_s)
            lane.withheld[WithheldCause.FAILED.value] += 1
            return
        super().offer(lane, message, now_s, source=source, expires_s=expires_s)
        if len(message) + PASSENGER_BYTES > _TOGETHER_BYTES:
            lane.key = None  # for good: a later small one must not overtake it on another writer

    def take(self, now_s: float) -> Ready | None:
        """Return what leaves now; it then counts as sent."""
        if self._flight.is_out(now_s):
            self._was_out = True
        elif self._was_out and self._is_open(now_s):
            self._was_out = False
            for each in self._active:
                each.give_up_old()
        return super().take(now_s)

    @property
    def is_held_up(self) -> bool:
        """Whether something waits because enough is on its way."""
        return bool(self._active) and not self._has_room()

    def _is_open(self, now_s: float) -> bool:
        return self._flight.has_room(is_small=True) and not self._flight.is_out(now_s)

    def _has_room(self) -> bool:
        return self._flight.has_room(is_small=False)

    def _turn_s(self, lane: Lane, now_s: float) -> float:
        return now_s if lane.current is not None else self._due_s(lane, now_s, in_turn=True)

    def _due_s(self, lane: Lane, now_s: float, *, in_turn: bool) -> float:
        due_s = super()._due_s(lane, now_s, in_turn=in_turn)
        return max(due_s, self._departs_s) if self._rides(lane) else due_s

    def _rides(self, lane: Lane) -> bool:
        """Return whether its next message leaves together with others."""
        return self._coach is not None and lane.key is not None and lane.current is None

    def _leave(self, lane: Lane, now_s: float, *, is_first: bool) -> Ready | None:
        """Return the message of a lane, and what leaves together with it; None where all that waited had expired."""
        if self._coach is None or not self._rides(lane):
            return super()._leave(lane, now_s, is_first=is_first)
        others = [each for each in self._active if each is not lane and self._rides(each)]
        boarding = {lane: is_first, **{each: True for each in others if self._comes_first(each, now_s)}}
        if self._free_s(now_s) <= now_s + SOON_S:
            in_turn = [each for each in others if each not in boarding and self._turn_s(each, now_s) <= now_s]
            boarding |= dict.fromkeys(sorted(in_turn, key=lambda each: each.start), False)
        aboard: dict[Lane, bytes] = {}
        room = _TOGETHER_BYTES
        self._departs_s = now_s + self._company_s
        for each in boarding:
            if each.next_bytes + PASSENGER_BYTES > room:
                self._departs_s = now_s
            elif (current := each.begin(now_s)) is None:
                del self._active[each]
            else:
                aboard[each] = current.message
                room -= len(current.message) + PASSENGER_BYTES
        if not aboard:
            return None
        message = join([(each.key or b"", sample) for each, sample in aboard.items()])
        number, wire_bytes, packets = self._send(self._coach, message, now_s, asks_every_s=QUICK_HEARTBEAT_S)
        self.sent_bytes += int(wire_bytes)
        shared = (wire_bytes - sum(map(len, aboard.values()))) / len(aboard)
        for each, sample in aboard.items():
            share = Part(sample, len(sample) + shared, packets / len(aboard))
            self._count(each, share, now_s, is_first=boarding[each])
            self._end(each, now_s)
        departed_us = int(now_s * 1e6) % WRAP
        chunk = Chunk(self._session, number, departed_us, number, 0, len(message), is_kept=False, part=message)
        return Ready(self._coach, encode_chunk(chunk))

    def _cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_first: bool) -> Part:
        message, offset = current.message, current.offset
        most = len(message) if is_first else self._chunk_bytes
        part = message if offset == 0 and most >= len(message) else message[offset : offset + most]
        number, wire_bytes, packets = self._send(lane, part, now_s, asks_every_s=HEARTBEAT_S)
        if offset == 0:
            current.number = number
        current.offset += len(part)
        departed_us = int(now_s * 1e6) % WRAP
        chunk = Chunk(self._session, number, departed_us, current.number, offset, len(message), lane.is_kept, part)
        return Part(encode_chunk(chunk), wire_bytes, packets)

    def _send(self, lane: Lane, part: bytes, now_s: float, *, asks_every_s: float) -> tuple[int, float, float]:
        """Count a chunk as sent; return its number, and the bytes and packets that it takes of the link."""
        wire_bytes, packets = wire_size(len(part) + CHUNK_HEADER_BYTES, rate_hz=math.inf)
        wire_bytes += self._asking_bytes(lane, now_s, asks_every_s)
        return self._flight.send(int(wire_bytes), now_s), wire_bytes, packets

    @property
    def _drain_rate(self) -> float:
        return min(MOST_SHARE, self._share * self._flight.relief)

    def _settle(self, now_s: float) -> None:
        if self._is_settled:
            return
        super()._settle(now_s)
        if (price := self._price) is not None:
            used = sum(1.0 if lane.link_share is None else lane.link_share for lane in self._lanes)
            self._share = max(LEAST_SHARE, min(price.budget_share, used + price.spare_share))
        self._adapt(None if price is None else price.capacity_bytes_per_second)

    def _adapt(self, capacity: float | None) -> None:
        """Let a chunk take its time of the link; None = no daemon is heard (bytes/s)."""
        self._flight.capacity = capacity
        packets = _UNKNOWN_PACKETS if capacity is None else round(_CHUNK_S * capacity / FRAGMENT_BYTES)
        packets = min(max(packets, _LEAST_PACKETS), _MOST_PACKETS)
        self._chunk_bytes = packets * FRAGMENT_BYTES - CHUNK_HEADER_BYTES
        self._company_s = min(_COMPANY_S, _COMPANY_PACKETS * FRAGMENT_BYTES / (capacity or math.inf))
