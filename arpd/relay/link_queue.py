"""The paced queue of an end: messages cross in chunks, and the other end confirms what has arrived. Pure."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import TYPE_CHECKING

from arpd.endpoint.lane import SMALL_BYTES, Lane, UnderWay
from arpd.endpoint.queue import LEAST_SHARE, MOST_SHARE, MOST_SMALL_DEBT_S, Debt, PacedQueue, Part, Ready, Times
from arpd.model.endpoints import WithheldCause
from arpd.model.price import LARGE_SHARE
from arpd.model.wire import (
    CLEAN_LOSS_RATIO,
    FRAGMENT_BYTES,
    LINK_HEARTBEAT_S,
    datagram_payload,
    datagram_size,
    wire_size,
)
from arpd.relay.envelope import CHUNK_HEADER_BYTES, MOST_MESSAGE_BYTES, WRAP, Chunk, decode_chunk, encode_chunk
from arpd.relay.flight import SIGN_BYTES, Flight, Received, Sign, decode_sign, encode_sign
from arpd.relay.partner import EVERY_S, REPLACED_S
from arpd.relay.turns import Turns

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_CHUNK_S = 0.0025  # of the link; samples of one packet wait behind one chunk
_LEAST_PACKETS, _MOST_PACKETS = 2, 16
_UNKNOWN_PACKETS = 4
# Small messages wait for others: so many packets' time, at most so long, and so long on any link, because a packet
# costs both ends as much as the samples in it.
_COMPANY_PACKETS, _COMPANY_S, _LEAST_COMPANY_S = 2.0, 0.005, 0.002
_WAY_S = 0.02  # beyond the last sign that this process lacks the processor
_MOST_MISSES = 8  # lanes in a row whose message has no room beside those that leave together
_SMALL_SHARE = 1.0 - LARGE_SHARE  # topics of one packet have it before large ones, whatever their rates are
_LEAST_DRAIN = 0.2  # of the link, for that: the robot's topics may leave the base's commands next to nothing
_TOGETHER_BYTES = FRAGMENT_BYTES - CHUNK_HEADER_BYTES
_PROBE_S, _PROMPT_S = 0.1, 30.0  # a probe while the link is out, and how long they come so often


class LinkQueue(PacedQueue):
    """Cuts large messages into chunks, so that small ones wait behind one chunk at most.

    A message under way is finished before the next one of its topic. The queue drains at the share of the link that its
    topics' rates take at the price, and what no topic of any process takes. What is left serves small topics beyond
    their rate, too; those of one packet have most of it before all large ones, so where they fit no picture costs them
    a sample. Without a daemon only what is on its way bounds it.

    Small messages of several topics leave together: of a sample of 300 bytes its own packet, heartbeat and
    acknowledgement would be the larger part. Those that come within the time of two packets, 2 to 5 ms, wait for each
    other; a message that comes after a pause waits for none.

    Where the link loses next to nothing, each chunk of a large message is one datagram, which IP cuts into packets: of
    the headers of the middleware that is one instead of several, so a tenth more crosses. Else Fast DDS cuts it: one
    lost packet would cost the datagram, and the other end's kernel keeps what is left of each for half a minute.

    Signs of life go past the queue. They carry the receipts of both ends.

    Parameters
    ----------
    now_s : when it begins (s)
    together : writes the messages that leave together
    freight : writes a chunk of any topic in one datagram
    asleep_s : returns how long this computer has slept, when the clock stood still: by a clock that stands still at one
        end alone, all samples afterwards would be as old as the sleep was long (s)

    Attributes
    ----------
    flight : what is on its way
    """

    _heartbeat_s = LINK_HEARTBEAT_S

    def __init__(
        self,
        session: int,
        now_s: float,
        *,
        together: Callable[[bytes], None],
        freight: Callable[[bytes], None],
        asleep_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        super().__init__()
        self._session, self._asleep_s = session, asleep_s
        self.flight = Flight()
        self._coach, self._freight = Lane(together), Lane(freight)
        self._carrier = self._freight  # whose writer takes the chunk that leaves
        self._is_clean = False
        self._turns = Turns(super()._finish)
        self._small_debt = Debt()
        self._expects_s = -math.inf  # when messages leave together, and others will most likely have come
        self._share = math.inf  # link time a second, may be spent
        self._was_out = False
        self._received = Received()
        self._received_bytes = 0.0  # on the link
        self._sign_s = self._probe_s = now_s
        self._is_answering = False  # a probe wants its receipt
        self._partner = 0  # session of the other end
        self._partner_s = -math.inf  # when that was heard last
        self._adapt(None)

    # -- signs of life and receipts

    def take_sign(self, now_s: float) -> bytes | None:
        """Return the sign of life that leaves now, None if none is due."""
        is_probing = now_s >= max(self.flight.out_s, self._probe_s)
        if not (self._is_answering or is_probing or now_s >= min(self._sign_s, self._received.due_s())):
            return None
        self._is_answering = False
        self._sign_s = now_s + EVERY_S
        number = 0
        if is_probing:
            is_short = now_s - self.flight.out_s < _PROMPT_S
            self._probe_s = now_s + (_PROBE_S if is_short else EVERY_S)
            number = self.flight.send(SIGN_BYTES, now_s, size=0)
        return encode_sign(Sign(self._session, number, self._departed_us(now_s), self._received.take(now_s)))

    @property
    def sign_s(self) -> float:
        """When `take_sign` may have something, or the link is out, unless a receipt comes before (s)."""
        return min(self._sign_s, self._received.due_s(), max(self.flight.out_s, self._probe_s))

    def follow(self, partner: int, now_s: float) -> bool:
        """Take the session of the other end, 0 = none; return whether it is new, and knows nothing of what was sent."""
        if partner == self._partner:
            return False
        self._partner, self._partner_s = partner, now_s if partner else -math.inf
        self.flight.restart()
        return True

    def arrived(
        self, sample: bytes, now_s: float, *, is_together: bool = False, is_freight: bool = False
    ) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; return it, and its age (s). Raises ValueError if the sample holds none.

        Parameters
        ----------
        is_together : whether it holds small messages, whose writer asks seldom for an acknowledgement
        is_freight : whether it is one datagram
        """
        chunk, size = decode_chunk(sample), len(sample)
        rate_hz = math.inf if chunk.offset or is_together else 0.0
        self._received_bytes += (datagram_size(size) if is_freight else wire_size(size, rate_hz=rate_hz))[0]
        if not self._is_of_partner(chunk.session, now_s):
            return chunk, 0.0
        arrived_s = now_s + self._asleep_s()
        return chunk, self._received.note(chunk.session, chunk.number, chunk.departed_us, size, arrived_s)

    def hear(self, data: bytes, now_s: float) -> int:
        """Take a sign of life of the other end; return its session. Raises ValueError if the bytes are none."""
        sign = decode_sign(data)
        is_of_partner = self._is_of_partner(sign.session, now_s)
        if is_of_partner and sign.receipt.session == self._session:
            self.flight.confirm(sign.receipt, now_s)
        arrived_s = now_s + self._asleep_s()
        if sign.number and is_of_partner:
            self._received.note(sign.session, sign.number, sign.departed_us, 0, arrived_s)
            self._is_answering = True
        self._received.hear(sign.session, sign.departed_us, arrived_s)
        return sign.session

    def _is_of_partner(self, session: int, now_s: float) -> bool:
        """Return whether a process speaks for the other end; another robot's in this domain would spoil the account."""
        if session == self._partner:
            self._partner_s = now_s
        return session == self._partner or now_s - self._partner_s > REPLACED_S

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self.sent_bytes + int(self._received_bytes)

    # -- what waits

    def make_way(self, now_s: float) -> None:
        """Let large messages wait a moment, because small ones wait for the processor that their chunks take."""
        self._way_s = now_s + _WAY_S

    def remove(self, lane: Lane) -> None:
        """Serve it no more, if it is served; what waits is withheld."""
        super().remove(lane)
        self._turns.drop(lane)

    def retune(self, lane: Lane, plan: TopicPlan, price: Price | None) -> None:
        """Give a lane its plan and the price; None = no daemon is there."""
        super().retune(lane, plan, price)
        if lane in self._active:
            self._turns.touch(lane)

    def offer(
        self, lane: Lane, message: bytes, now_s: float, *, source: Hashable = None, expires_s: float = math.inf
    ) -> None:
        """Let a message wait for its turn; `Lane.offer` explains the arguments."""
        if len(message) > MOST_MESSAGE_BYTES:
            lane.offered_rate.count(now_s)
            lane.withheld[WithheldCause.FAILED.value] += 1
            return
        super().offer(lane, message, now_s, source=source, expires_s=expires_s)
        if lane.has_company and len(message) > _TOGETHER_BYTES:
            self._turns.drop(lane)
            lane.has_company = False  # for good: a later small one must not overtake it on another writer
        if len(message) > SMALL_BYTES and not lane.is_kept:
            lane.may_be_freight = True  # for good, too
        self._turns.touch(lane)

    def take(self, now_s: float) -> Ready | None:
        """Return what leaves now; it then counts as sent."""
        if self._is_out(now_s):
            self._was_out = True
        elif self._was_out and self._is_open(now_s):
            self._was_out = False
            for each in self._active:
                each.give_up_old()
            self._turns.touch(*self._active)
        return super().take(now_s)

    def due_s(self, now_s: float) -> float:
        """Return when `take` may have something, ``inf`` = not before something changes (s).

        Where much comes there will be something: so neither a message that may not leave yet has to wake the thread,
        nor a chunk whose receipt is not due.
        """
        due_s = super().due_s(now_s)
        if self._active and self._is_open(now_s):
            due_s = min(due_s, self._early_s(now_s))
        return min([due_s, *(each_s for each_s in (self._expects_s, self._received.expects_s) if each_s > now_s)])

    def _choose(self, now_s: float) -> tuple[Lane, bool] | None:
        chosen = super()._choose(now_s)
        if (chosen is None or not chosen[1]) and self._early_s(now_s) <= now_s:
            return self._turns.in_turn.together.ready(now_s)[0], False
        return chosen

    def _first(self, now_s: float) -> Times:
        self._turns.update(now_s)
        return self._turns.first

    def _in_turn(self, now_s: float) -> Times:
        self._turns.update(now_s)
        return self._turns.in_turn

    def _finish(self, lane: Lane) -> float:
        return self._turns.finish[lane]

    def _is_open(self, now_s: float) -> bool:
        return self.flight.has_room(is_small=True) and not self._is_out(now_s)

    def _is_out(self, now_s: float) -> bool:
        return now_s >= self.flight.out_s

    def _has_room(self) -> bool:
        return self.flight.has_room(is_small=False)

    def _leave(self, lane: Lane, now_s: float, *, is_first: bool) -> Ready | None:
        """Return the message of a lane, and what leaves together with it; None where all that waited had expired."""
        if not lane.has_company:
            ready = super()._leave(lane, now_s, is_first=is_first)
            return ready and ready._replace(lane=self._carrier)
        first = self._turns.first.together.ready(now_s)
        boarding = {lane: is_first, **{each: True for each in first if each is not lane}}
        is_early = self._early_s(now_s) <= now_s
        if is_early or (not self._is_behind(now_s) and self._free_s(now_s) <= now_s + self._company_s):
            in_turn = [each for each in self._turns.in_turn.together.ready(now_s) if each not in boarding]
            boarding |= dict.fromkeys(sorted(in_turn, key=attrgetter("start")), False)
        aboard: list[tuple[Lane, bytes]] = []
        room, misses, is_full = self._room, 0, False
        for each, is_due in boarding.items():
            when = each.spare_s if is_early else each.first_s
            messages = self._board(each, room, now_s, when)
            aboard += [(each, message) for message in messages]
            room -= sum(map(len, messages))
            is_full |= each in self._active and (not messages or ((is_early or is_due) and when(now_s) <= now_s))
            misses = 0 if messages else misses + 1
            if misses == _MOST_MISSES:
                break
        departs_s = now_s if is_full else now_s + self._company_s
        self._turns.first.departs_s = self._turns.in_turn.departs_s = departs_s
        self._expects_s = departs_s if len(aboard) > 1 else -math.inf
        if not aboard:
            return None
        message = b"".join(message for _, message in aboard)
        part = self._cut(self._coach, UnderWay(None, message), now_s, is_first=True)
        self.sent_bytes += int(part.wire_bytes)
        shared = (part.wire_bytes - len(message)) / len(aboard)
        for each, sample in aboard:
            share = Part(sample, len(sample) + shared, part.packets / len(aboard))
            self._count(each, share, now_s, is_first=boarding[each])
        return Ready(self._coach, part.sample)

    def _board(self, lane: Lane, room: int, now_s: float, when: Callable[[float], float]) -> list[bytes]:
        """Return what leaves of a lane together with others: one message, and all that may by now and has room."""
        aboard: list[bytes] = []
        while lane in self._active and lane.next_bytes <= room and (not aboard or when(now_s) <= now_s):
            if (current := lane.begin(now_s)) is None:
                del self._active[lane]
                break
            aboard.append(current.message)
            room -= len(current.message)
            self._end(lane, now_s)
        if aboard or lane not in self._active:
            self._put_behind(lane)
        return aboard

    def _begin(self, lane: Lane, now_s: float, *, is_first: bool) -> bytes | None:
        part = super()._begin(lane, now_s, is_first=is_first)
        self._put_behind(lane)
        return part

    def _put_behind(self, lane: Lane) -> None:
        self._turns.drop(lane)
        if lane in self._active:
            self._turns.touch(lane)

    def _count(self, lane: Lane, part: Part, now_s: float, *, is_first: bool) -> None:
        super()._count(lane, part, now_s, is_first=is_first)
        if is_first or lane.has_company:
            lane.charge(part.packets, part.wire_bytes)
            if self._price is not None:
                self._small_debt.owe(self._price.time_s(part.packets, part.wire_bytes), most_s=MOST_SMALL_DEBT_S)

    def _cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_first: bool) -> Part:
        is_held = now_s < self.flight.freight.held_until_s
        if current.is_freight and is_held:
            current.offset = 0  # what has left of it does not arrive
        message, offset = current.message, current.offset
        if offset == 0:  # to the end of the message, because writers overtake each other
            current.is_freight = lane.may_be_freight and self._is_clean and not is_held
        self._carrier = self._freight if current.is_freight else lane
        chunk_bytes = self._freight_bytes if current.is_freight else self._chunk_bytes
        part = message[offset:] if is_first else message[offset : offset + chunk_bytes]
        size = len(part) + CHUNK_HEADER_BYTES
        wire_bytes, packets = datagram_size(size) if current.is_freight else wire_size(size, rate_hz=math.inf)
        wire_bytes += self._asking_bytes(self._carrier, now_s)
        number = self.flight.send(int(wire_bytes), now_s, size=size, is_freight=current.is_freight)
        if offset == 0:
            current.number = number
        current.offset += len(part)
        departed_us, total = self._departed_us(now_s), len(message)
        chunk = Chunk(self._session, number, departed_us, current.number, offset, total, lane.is_kept, part)
        return Part(encode_chunk(chunk), wire_bytes, packets)

    def _departed_us(self, now_s: float) -> int:
        return int((now_s + self._asleep_s()) * 1e6) % WRAP

    # -- the daemon's price

    def _early_s(self, now_s: float) -> float:
        """Return when a topic of one packet may leave beyond its rate, before large ones (s)."""
        share = _SMALL_SHARE - LARGE_SHARE * self._is_behind(now_s)  # a large topic catches up at twice its floor
        paid_s = self._small_debt.paid_s(now_s, share * max(self._drain_rate, _LEAST_DRAIN))
        return max(self._turns.in_turn.together_s, paid_s)

    def _is_behind(self, now_s: float) -> bool:
        return self._behind(self._turns.in_turn).due_s <= now_s

    @property
    def _drain_rate(self) -> float:
        return min(MOST_SHARE, self._share * self.flight.relief)

    def _settle(self, now_s: float) -> None:
        if self._is_settled:
            return
        before = self._price
        super()._settle(now_s)
        if self._price != before:  # by which every message may keep others waiting, of lanes without a price, too
            self._turns.touch(*self._active)
        if (price := self._price) is not None:
            used = sum(1.0 if lane.link_share is None else lane.link_share for lane in self._lanes)
            self._share = max(LEAST_SHARE, min(price.budget_share, used + price.spare_share))
        self._adapt(price)

    def _adapt(self, price: Price | None) -> None:
        """Let a chunk take its time of the link; None = no daemon is heard."""
        capacity = math.inf if price is None else price.capacity_bytes_per_second
        is_lossy = price is not None and (price.loss_ratio or 0.0) >= CLEAN_LOSS_RATIO
        self._is_clean = price is not None and price.loss_ratio is not None and not is_lossy
        self.flight.believe(capacity, is_lossy=is_lossy)
        packets = _UNKNOWN_PACKETS if price is None else round(_CHUNK_S * capacity / FRAGMENT_BYTES)
        packets = min(max(packets, _LEAST_PACKETS), _MOST_PACKETS)
        self._chunk_bytes = packets * FRAGMENT_BYTES - CHUNK_HEADER_BYTES
        self._freight_bytes = datagram_payload(packets) - CHUNK_HEADER_BYTES
        # For messages that leave together: a lost packet holds them all up.
        self._room = _TOGETHER_BYTES if is_lossy else self._chunk_bytes
        self._company_s = min(_COMPANY_S, max(_LEAST_COMPANY_S, _COMPANY_PACKETS * FRAGMENT_BYTES / capacity))
