"""The one paced queue of a relay's end: what goes onto the link next, and when. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from arpd.apply.relay.envelope import CHUNK_HEADER_BYTES, WRAP, Chunk, encode_chunk
from arpd.apply.relay.lane import SMALL_BYTES
from arpd.model.wire import ACKNACK_BYTES, FRAGMENT_BYTES, HEARTBEAT_BYTES, HEARTBEAT_S, wire_size

if TYPE_CHECKING:
    from collections.abc import Hashable

    from arpd.apply.relay.flight import Flight
    from arpd.apply.relay.lane import Lane, UnderWay
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_CHUNK_S = 0.0025  # of the link; samples of one packet wait behind one chunk
_LEAST_PACKETS, _MOST_PACKETS = 2, 16
_UNKNOWN_PACKETS = 4
_SLACK_S = 0.01  # that a late thread may catch up
_LEAST_SHARE = 0.05  # of the link: for calls, the ends' own messages and topics without a plan
_MOST_SHARE = 0.97
_MOST_DEBT_S = 0.1  # of link time: what a share that was low for a moment cost is no debt for long
_SOON_S = 0.0005  # to wake a thread for less costs more than it saves


class Ready(NamedTuple):
    """A chunk that leaves now: its lane, and its serialized bytes."""

    lane: Lane
    sample: bytes


class PacedQueue:
    """Decides which chunk of which topic leaves next.

    Samples of at most ten packets come first, each topic within its allowed rate. Then comes start-time fair queueing
    by weight (Goyal, Vin and Cheng, SIGCOMM 1996), topics below their floor before the others; what is left of the link
    serves small topics beyond their rate, too. A message under way is finished before the next one of its topic.

    It drains at the share of the link that its topics' rates take at the price, and what no topic of any process takes.
    Without a daemon only the receipts bound it (`Flight`).

    Parameters
    ----------
    session : of this process, 32 bit
    flight : what is on its way

    Notes
    -----
    Not thread-safe. Times are seconds of one monotonic clock.
    """

    def __init__(self, session: int, flight: Flight) -> None:
        self._session = session
        self.flight = flight
        self._lanes: list[Lane] = []
        self._active: dict[Lane, None] = {}  # with something to send, the longest active first
        self._virtual = 0.0
        self.sent_bytes = 0  # on the link
        self._free_s = -math.inf  # when the share of the link is free again
        self._price: Price | None = None
        self._share = math.inf  # link time a second, may be spent
        self._was_out = False
        self._is_settled = True  # price and share belong to what the lanes have

    def add(self, lane: Lane) -> None:
        """Serve a lane from now on."""
        self._lanes.append(lane)

    def remove(self, lane: Lane) -> None:
        """Serve it no more; what waits is withheld."""
        lane.close()
        self._lanes.remove(lane)
        self._active.pop(lane, None)
        self._is_settled = False

    def retune(self, lane: Lane, plan: TopicPlan | None, price: Price | None) -> None:
        """Give a lane its plan and the price; None = there is none."""
        lane.retune(plan, price)
        self._is_settled = False

    def offer(
        self, lane: Lane, message: bytes, now_s: float, *, source: Hashable = None, expires_s: float = math.inf
    ) -> None:
        """Let a message wait for its turn; `Lane.offer` explains the arguments."""
        lane.offer(message, now_s, source=source, expires_s=expires_s, is_held_up=not self._is_open(now_s))
        if lane not in self._active:
            self._active[lane] = None
            lane.start = max(lane.start, self._virtual)

    def take(self, now_s: float) -> Ready | None:
        """Return the chunk that leaves now; it then counts as sent."""
        if not self._active or not self._is_open(now_s):
            self._was_out = self._was_out or self.flight.is_out(now_s)
            return None
        if self._was_out:
            self._was_out = False
            for each in self._active:
                each.give_up_old()
        self._settle()
        while (chosen := self._choose(now_s)) is not None:
            lane, is_first = chosen
            current = lane.current or lane.begin(now_s)
            if current is not None:
                is_first = is_first and len(current.message) <= SMALL_BYTES
                return Ready(lane, self._send(lane, current, now_s, is_first=is_first))
            del self._active[lane]  # all had expired
        return None

    def due_s(self, now_s: float) -> float:
        """Return when `take` may have something, ``inf`` = not before something changes (s)."""
        if not self._active or not self._is_open(now_s):
            return math.inf
        first_s = min(
            (lane.due_s(now_s, in_turn=False) for lane in self._active if lane.is_small),
            default=math.inf,
        )
        if not self.flight.has_room(is_small=False):
            return first_s
        in_turn_s = min(now_s if lane.current is not None else lane.due_s(now_s, in_turn=True) for lane in self._active)
        return min(first_s, max(in_turn_s, self._free_s))

    @property
    def is_held_up(self) -> bool:
        """Whether something waits because enough is on its way."""
        return bool(self._active) and not self.flight.has_room(is_small=False)

    def _is_open(self, now_s: float) -> bool:
        return self.flight.has_room(is_small=True) and not self.flight.is_out(now_s)

    def _choose(self, now_s: float) -> tuple[Lane, bool] | None:
        """Return the lane whose turn it is, and whether it comes before large ones; None where nothing may leave."""
        for lane in self._active:
            if lane.is_small and lane.due_s(now_s, in_turn=False) <= now_s:
                return lane, True
        if now_s < self._free_s - _SOON_S or not self.flight.has_room(is_small=False):
            return None
        ready = [lane for lane in self._active if lane.current is not None or lane.due_s(now_s, in_turn=True) <= now_s]
        if not ready:
            return None
        return min(ready, key=lambda lane: (not lane.is_behind(now_s), lane.start)), False

    def _send(self, lane: Lane, current: UnderWay, now_s: float, *, is_first: bool) -> bytes:
        """Cut the next chunk of a message, and count what it takes of the link."""
        message, offset = current.message, current.offset
        most = len(message) if is_first else self._chunk_bytes
        part = message[offset : offset + most] if most < len(message) else message
        size, packets = wire_size(len(part) + CHUNK_HEADER_BYTES, rate_hz=math.inf)
        if now_s - lane.asked_s >= HEARTBEAT_S:
            lane.asked_s = now_s
            size += HEARTBEAT_BYTES + ACKNACK_BYTES
        self.sent_bytes += int(size)
        number = self.flight.send(int(size), now_s)
        if offset == 0:
            current.number = number
        chunk = Chunk(
            self._session,
            number,
            int(now_s * 1e6) % WRAP,
            current.number,
            offset,
            len(message),
            lane.is_kept,
            part,
        )
        price = self._price
        if not is_first:
            self._virtual = max(self._virtual, min(each.start for each in self._active))
            lane.start += size / lane.weight
        if price is not None:
            cost = packets * price.packet_overhead_s + size / price.capacity_bytes_per_second
            drained = min(_MOST_SHARE, self._share * self.flight.relief)
            free_s = max(self._free_s, now_s - _SLACK_S) + cost / drained
            self._free_s = min(free_s, now_s + _MOST_DEBT_S)
        current.offset += len(part)
        if current.offset >= len(message):
            lane.ended(now_s)
            del self._active[lane]
            if len(lane):
                self._active[lane] = None  # behind the others
        return encode_chunk(chunk)

    @property
    def _chunk_bytes(self) -> int:
        packets = _UNKNOWN_PACKETS
        if self._price is not None:
            packets = round(_CHUNK_S * self._price.capacity_bytes_per_second / FRAGMENT_BYTES)
        return min(max(packets, _LEAST_PACKETS), _MOST_PACKETS) * FRAGMENT_BYTES - CHUNK_HEADER_BYTES

    def _settle(self) -> None:
        """Follow the price and the plans of the lanes."""
        if self._is_settled:
            return
        self._is_settled = True
        self._price = price = next((lane.price for lane in self._lanes if lane.price is not None), None)
        self.flight.capacity = None
        if price is None:
            self._free_s = -math.inf
        else:
            used = sum(lane.link_share for lane in self._lanes)
            self._share = max(_LEAST_SHARE, min(price.budget_share, used + price.spare_share))
            self.flight.capacity = price.capacity_bytes_per_second
