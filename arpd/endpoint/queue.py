"""The one paced queue of a participant: what goes onto the link next, and when. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, Protocol

from arpd.endpoint.lane import SMALL_BYTES
from arpd.model.endpoints import WithheldCause
from arpd.model.wire import ACKNACK_BYTES, HEARTBEAT_BYTES, HEARTBEAT_S, QUICK_HEARTBEAT_S, wire_size

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from arpd.endpoint.lane import Lane, UnderWay
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_SLACK_S = 0.01  # that a late thread may catch up
_LEAST_SHARE = 0.05  # of the link: for calls, the ends' own messages and topics without a plan
_MOST_SHARE = 0.97
_MOST_SMALL_DEBT_S = 0.05  # of link time: small messages have rates of their own, and must not starve large ones
_SOON_S = 0.0005  # to wake a thread for less costs more than it saves


class Part(NamedTuple):
    """What leaves of a message at once: its serialized bytes, and what they take of the link."""

    sample: bytes
    wire_bytes: float
    packets: float


class Ready(NamedTuple):
    """A sample that leaves now, and its lane."""

    lane: Lane
    sample: bytes


class Carrier(Protocol):
    """How messages cross the link, and what of them is on its way there.

    Attributes
    ----------
    most_bytes : largest message
    has_receipts : whether the other end tells what has arrived. Then what one topic leaves of the link others have at
        once, beyond their rates at the price, and topics without a plan have all
    together_bytes, seat_bytes : what small messages may take that leave together, and each takes beside its own bytes
    company_s : time that a small message may wait for others (s)
    """

    most_bytes: float
    has_receipts: bool
    together_bytes: int
    seat_bytes: int
    company_s: float

    def has_room(self, *, is_small: bool) -> bool:
        """Return whether one more part may leave; a small message may where a large one has to wait."""

    def is_out(self, now_s: float) -> bool:
        """Return whether the link is out."""

    @property
    def relief(self) -> float:
        """Times its share that the queue drains."""

    def adapt(self, capacity: float | None) -> None:
        """Take what the link carries, as the daemon says; None = no daemon is heard (bytes/s)."""

    def cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_whole: bool, asking_bytes: float) -> Part:
        """Return the next part of a message, which then counts as sent.

        Parameters
        ----------
        asking_bytes : of the link, that the acknowledgement takes which it asks for
        """

    def join(self, messages: Sequence[tuple[bytes, bytes]], now_s: float, *, asking_bytes: float) -> Part:
        """Return one part with the keys and messages of several topics, which then count as sent."""


class Whole:
    """Samples cross whole, for readers that know nothing of arpd; nobody tells what has arrived."""

    most_bytes, has_receipts, relief = math.inf, False, 1.0
    together_bytes, seat_bytes, company_s = 0, 0, 0.0

    def has_room(self, *, is_small: bool) -> bool:  # noqa: ARG002 - as a `Carrier`
        """Return True."""
        return True

    def is_out(self, now_s: float) -> bool:  # noqa: ARG002 - as a `Carrier`
        """Return False."""
        return False

    def adapt(self, capacity: float | None) -> None:
        """Do nothing."""

    def cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_whole: bool, asking_bytes: float) -> Part:  # noqa: ARG002
        """Return all of it."""
        current.offset = len(current.message)
        size, packets = wire_size(len(current.message), rate_hz=math.inf)
        return Part(current.message, size + asking_bytes, packets)

    def join(self, messages: Sequence[tuple[bytes, bytes]], now_s: float, *, asking_bytes: float) -> Part:
        """Raise: plain readers cannot take them apart."""
        raise NotImplementedError


class PacedQueue:
    """Decides which part of which topic's messages leaves next.

    Samples of at most ten packets come first, each topic within its allowed rate. Then comes start-time fair queueing
    by weight (Goyal, Vin and Cheng, SIGCOMM 1996), topics below their floor before the others. A message under way is
    finished before the next one of its topic.

    With receipts it drains at the share of the link that its topics' rates take at the price, and what no topic of any
    process takes; what is left serves small topics beyond their rate, too. Without receipts no topic exceeds its rate
    at the price, and a large sample waits until the one before has crossed the link. A topic that has no plan yet has
    what is spare, as a TCP sender begins with a small window (RFC 5681 §3.1): a robot that starts its cameras on a weak
    link would fill every queue.

    Without a daemon only its carrier bounds it.

    Small messages of several topics leave together in one packet, where there is a writer for that: of a sample of 300
    bytes its own packet, heartbeat and acknowledgement would be the larger part. Those that come within the time of two
    packets wait for each other; a message that comes after a pause waits for none.

    Parameters
    ----------
    carrier : how messages cross the link
    coach : lane of the writer of messages that leave together; None = each leaves alone

    Notes
    -----
    Not thread-safe. Times are seconds of one monotonic clock.
    """

    def __init__(self, carrier: Carrier, coach: Lane | None = None) -> None:
        self._carrier = carrier
        self._coach = coach
        self._departs_s = -math.inf  # when the next messages leave together
        self._lanes: list[Lane] = []
        self._active: dict[Lane, None] = {}  # with something to send, the longest active first
        self._virtual = 0.0
        self.sent_bytes = 0  # on the link
        self._debt_s = 0.0  # link time that is still to pass for what has left
        self._drained_s = -math.inf  # as of when
        self._price: Price | None = None
        self._share = math.inf  # link time a second, may be spent
        self._unplanned_s = -math.inf  # without receipts: when a large sample without a plan may leave
        self._was_out = False
        self._is_settled = True  # price and share belong to what the lanes have

    def __len__(self) -> int:
        return len(self._lanes)

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
        if len(message) > self._carrier.most_bytes:
            lane.offered_rate.count(now_s)
            lane.withheld[WithheldCause.FAILED.value] += 1
            return
        lane.offer(message, now_s, source=source, expires_s=expires_s, is_held_up=not self._is_open(now_s))
        if lane not in self._active:
            self._active[lane] = None
            lane.start = max(lane.start, self._virtual)
        if len(message) + self._carrier.seat_bytes > self._carrier.together_bytes:
            lane.key = None  # for good: a later small one must not overtake it on another writer

    def take(self, now_s: float) -> Ready | None:
        """Return what leaves now; it then counts as sent."""
        if not self._active or not self._is_open(now_s):
            self._was_out = self._was_out or self._carrier.is_out(now_s)
            return None
        if self._was_out:
            self._was_out = False
            for each in self._active:
                each.give_up_old()
        self._settle()
        while (chosen := self._choose(now_s)) is not None:
            lane, is_first = chosen
            if self._rides(lane):
                if (ready := self._depart(lane, now_s, is_first=is_first)) is not None:
                    return ready
            elif (sample := self._begin(lane, now_s, is_first=is_first)) is not None:
                return Ready(lane, sample)
        return None

    def admit(self, lane: Lane, message: bytes, now_s: float) -> bool:
        """Let a small message pass at once where nothing keeps it; return whether it did, and then counts as sent.

        For samples that cross whole: what `offer` and `take_of` would do, in a fraction of their time.
        """
        if len(message) > SMALL_BYTES or lane.claimant is not None or not lane.admit(message, now_s):
            return False
        self._settle()
        if self._price is not None and lane.plan is not None:
            debt_s = self._drain(now_s) + self._price.cost_s(lane.plan)
            self._debt_s = max(self._debt_s, min(debt_s, _MOST_SMALL_DEBT_S))
        return True

    def take_of(self, lane: Lane, now_s: float) -> bytes | None:
        """Return what leaves now of this lane, if it is its turn; it then counts as sent."""
        if lane.claimant is not None or lane not in self._active or not self._is_open(now_s):
            return None
        self._settle()
        is_first = self._comes_first(lane, now_s)
        if not is_first and ((chosen := self._choose(now_s)) is None or chosen[0] is not lane):
            return None
        return self._begin(lane, now_s, is_first=is_first)

    def due_s(self, now_s: float) -> float:
        """Return when `take` may have something, ``inf`` = not before something changes (s)."""
        if not self._active or not self._is_open(now_s):
            return math.inf
        free = [lane for lane in self._active if lane.claimant is None]
        first_s = min(
            (self._due_s(lane, now_s, in_turn=False) for lane in free if lane.is_small or lane.is_unbound(now_s)),
            default=math.inf,
        )
        if not self._carrier.has_room(is_small=False):
            return first_s
        in_turn_s = min((self._turn_s(lane, now_s) for lane in free), default=math.inf)
        return min(first_s, max(in_turn_s, self._free_s(now_s)))

    @property
    def is_waiting(self) -> bool:
        """Whether anything waits."""
        return bool(self._active)

    @property
    def is_held_up(self) -> bool:
        """Whether something waits because enough is on its way."""
        return bool(self._active) and not self._carrier.has_room(is_small=False)

    def _is_open(self, now_s: float) -> bool:
        return self._carrier.has_room(is_small=True) and not self._carrier.is_out(now_s)

    def _choose(self, now_s: float) -> tuple[Lane, bool] | None:
        """Return the lane whose turn it is, and whether it comes before large ones; None where nothing may leave."""
        for lane in self._active:
            if self._comes_first(lane, now_s):
                return lane, True
        if self._free_s(now_s) > now_s + _SOON_S or not self._carrier.has_room(is_small=False):
            return None
        ready = [lane for lane in self._active if lane.claimant is None and self._turn_s(lane, now_s) <= now_s]
        if not ready:
            return None
        return min(ready, key=lambda lane: (not lane.is_behind(now_s), lane.start)), False

    def _turn_s(self, lane: Lane, now_s: float) -> float:
        """Return when a message may leave that waits for a share of the link (s)."""
        if lane.current is not None:
            return now_s
        due_s = self._due_s(lane, now_s, in_turn=self._carrier.has_receipts)
        return due_s if self._carrier.has_receipts or lane.link_share is not None else max(due_s, self._unplanned_s)

    def _comes_first(self, lane: Lane, now_s: float) -> bool:
        """Return whether the next message leaves now, before those that wait for a share of the link."""
        is_free = lane.claimant is None and (lane.is_small or lane.is_unbound(now_s))
        return is_free and self._due_s(lane, now_s, in_turn=False) <= now_s

    def _due_s(self, lane: Lane, now_s: float, *, in_turn: bool) -> float:
        due_s = lane.due_s(now_s, in_turn=in_turn)
        return max(due_s, self._departs_s) if self._rides(lane) else due_s

    def _rides(self, lane: Lane) -> bool:
        """Return whether its next message leaves together with others."""
        return self._coach is not None and lane.key is not None and lane.current is None

    def _depart(self, first: Lane, now_s: float, *, is_first: bool) -> Ready | None:
        """Return the message of a lane and what leaves together with it; None where all that waited had expired."""
        assert self._coach is not None
        others = [lane for lane in self._active if lane is not first and self._rides(lane)]
        boarding = {first: is_first, **{lane: True for lane in others if self._comes_first(lane, now_s)}}
        if self._free_s(now_s) <= now_s + _SOON_S:
            in_turn = [lane for lane in others if lane not in boarding and self._turn_s(lane, now_s) <= now_s]
            boarding |= dict.fromkeys(sorted(in_turn, key=lambda lane: lane.start), False)
        aboard: dict[Lane, bytes] = {}
        room = self._carrier.together_bytes
        self._departs_s = now_s + self._carrier.company_s
        for lane in boarding:
            if lane.next_bytes + self._carrier.seat_bytes > room:
                self._departs_s = now_s
            elif (current := lane.begin(now_s)) is None:
                del self._active[lane]
            else:
                aboard[lane] = current.message
                room -= len(current.message) + self._carrier.seat_bytes
        if not aboard:
            return None
        asking_bytes = self._asking_bytes(self._coach, now_s, QUICK_HEARTBEAT_S)
        messages = [(lane.key or b"", message) for lane, message in aboard.items()]
        part = self._carrier.join(messages, now_s, asking_bytes=asking_bytes)
        self.sent_bytes += int(part.wire_bytes)
        shared = (part.wire_bytes - sum(map(len, aboard.values()))) / len(aboard)
        for lane, message in aboard.items():
            share = Part(message, len(message) + shared, part.packets / len(aboard))
            self._count(lane, share, now_s, is_first=boarding[lane])
            self._end(lane, now_s)
        return Ready(self._coach, part.sample)

    def _begin(self, lane: Lane, now_s: float, *, is_first: bool) -> bytes | None:
        """Return the next part of a lane's message; None where all that waited had expired."""
        current = lane.current or lane.begin(now_s)
        if current is None:
            del self._active[lane]
            return None
        is_first = is_first and (len(current.message) <= SMALL_BYTES or lane.is_unbound(now_s))
        return self._send(lane, current, now_s, is_first=is_first)

    def _send(self, lane: Lane, current: UnderWay, now_s: float, *, is_first: bool) -> bytes:
        """Cut the next part of a message, and count what it takes of the link."""
        asking_bytes = self._asking_bytes(lane, now_s, HEARTBEAT_S)
        part = self._carrier.cut(lane, current, now_s, is_whole=is_first, asking_bytes=asking_bytes)
        self.sent_bytes += int(part.wire_bytes)
        self._count(lane, part, now_s, is_first=is_first)
        if current.offset >= len(current.message):
            self._end(lane, now_s)
        return part.sample

    @staticmethod
    def _asking_bytes(lane: Lane, now_s: float, every_s: float) -> int:
        """Return what the acknowledgement takes for which a writer asks now."""
        if now_s - lane.asked_s < every_s:
            return 0
        lane.asked_s = now_s
        return HEARTBEAT_BYTES + ACKNACK_BYTES

    def _count(self, lane: Lane, part: Part, now_s: float, *, is_first: bool) -> None:
        """Let a part take its share of the link."""
        price = self._price
        if not is_first:
            self._virtual = max(self._virtual, min(each.start for each in self._active))
            lane.start += part.wire_bytes / lane.weight
        if price is not None and not lane.is_unbound(now_s):
            cost_s = part.packets * price.packet_overhead_s + part.wire_bytes / price.capacity_bytes_per_second
            if lane.link_share is None and not is_first:
                self._unplanned_s = now_s + cost_s / max(_LEAST_SHARE, price.spare_share)
            debt_s = self._drain(now_s) + cost_s
            self._debt_s = max(self._debt_s, min(debt_s, _MOST_SMALL_DEBT_S)) if is_first else debt_s

    def _end(self, lane: Lane, now_s: float) -> None:
        lane.ended(now_s)
        del self._active[lane]
        if len(lane):
            self._active[lane] = None  # behind the others

    def _drain(self, now_s: float) -> float:
        """Let the link time since the last call pass; return what is still to pass, below 0 for what it might have."""
        rate = self._drain_rate
        passed_s = (now_s - self._drained_s) * rate if now_s > self._drained_s else 0.0
        self._debt_s = max(-_SLACK_S * rate, self._debt_s - passed_s)
        self._drained_s = max(self._drained_s, now_s)
        return self._debt_s

    def _free_s(self, now_s: float) -> float:
        """Return when its share of the link is free again (s)."""
        if self._price is None:
            return -math.inf
        return now_s + self._drain(now_s) / self._drain_rate

    @property
    def _drain_rate(self) -> float:
        if not self._carrier.has_receipts:
            return _MOST_SHARE
        return min(_MOST_SHARE, self._share * self._carrier.relief)

    def _settle(self) -> None:
        """Follow the price and the plans of the lanes."""
        if self._is_settled:
            return
        self._is_settled = True
        self._price = price = next((lane.price for lane in self._lanes if lane.price is not None), None)
        if price is not None:
            used = sum(1.0 if lane.link_share is None else lane.link_share for lane in self._lanes)
            self._share = max(_LEAST_SHARE, min(price.budget_share, used + price.spare_share))
        self._carrier.adapt(None if price is None else price.capacity_bytes_per_second)
