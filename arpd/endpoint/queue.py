"""The one paced queue of a participant: what goes onto the link next, and when. Pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from arpd.endpoint.lane import SMALL_BYTES, Lane, UnderWay
from arpd.model.endpoints import WithheldCause
from arpd.model.wire import ACKNACK_BYTES, HEARTBEAT_BYTES, HEARTBEAT_S, wire_size

if TYPE_CHECKING:
    from collections.abc import Hashable

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_SLACK_S = 0.01  # that a late thread may catch up
_FADE = 2.0  # a link that carries so much more than it did was in one; less is doubt
LEAST_SHARE, MOST_SHARE = 0.05, 0.97  # of the link
# Where two pictures of equal weight take turns of a chunk both are late; one after the other, only one is.
_UNBROKEN_S = 2.0  # of the link, that the rest of a message may keep others waiting
_AHEAD = 1.25  # more than headers add: a message under way stays before one that would end at the same time
MOST_SMALL_DEBT_S = 0.05  # of link time: small messages have rates of their own, and must not starve large ones
SOON_S = 0.0005  # to wake a thread for less costs more than it saves


class Part(NamedTuple):
    """What leaves of a message at once: its serialized bytes, and what they take of the link."""

    sample: bytes
    wire_bytes: float
    packets: float


class Ready(NamedTuple):
    """A sample that leaves now, and its lane."""

    lane: Lane
    sample: bytes


class Times(dict["Lane", float]):
    """When each of some lanes may leave (s)."""

    @property
    def due_s(self) -> float:
        """When the first of them may, ``inf`` = there is none (s)."""
        return min(self.values(), default=math.inf)

    def ready(self, now_s: float) -> list[Lane]:
        """Return the lanes that may leave now, in their order."""
        return [lane for lane, due_s in self.items() if due_s <= now_s]


class Debt:
    """Link time that is still to pass for what has left; below 0 for what might have.

    Attributes
    ----------
    time_s : as of the last call (s)
    """

    def __init__(self) -> None:
        self.time_s = 0.0
        self._at_s = -math.inf

    def drain(self, now_s: float, rate: float) -> float:
        """Let the time since the last call pass at a rate (link time a second); return what is left (s)."""
        passed_s = (now_s - self._at_s) * rate if now_s > self._at_s else 0.0
        self.time_s = max(-_SLACK_S * rate, self.time_s - passed_s)
        self._at_s = max(self._at_s, now_s)
        return self.time_s

    def paid_s(self, now_s: float, rate: float) -> float:
        """Return when nothing is left of it at a rate (s)."""
        return now_s + self.drain(now_s, rate) / rate

    def owe(self, time_s: float, *, most_s: float = math.inf) -> None:
        """Add time, until the debt is so long (s)."""
        self.time_s = max(self.time_s, min(self.time_s + time_s, most_s))


class PacedQueue:
    """Decides which topic's message leaves next; each crosses whole, and nobody tells what has arrived.

    Samples of at most ten packets come first, each topic within its allowed rate. Then comes fair queueing by weight:
    the message first that would end first (Demers, Keshav and Shenker, SIGCOMM 1989), in the virtual time of start-time
    fair queueing (Goyal, Vin and Cheng, SIGCOMM 1996). No topic exceeds its rate at the price, but for one that grows
    and costs little (`Price.growing_hz`). A large sample waits until the one before has crossed the link, but not if
    its topic is below its floor; then it leaves before all others that wait for a share of the link. A topic that has
    no plan yet has what is spare, as a TCP sender begins with a small window (RFC 5681 §3.1): a robot that starts its
    cameras on a weak link would fill every queue.

    Without a daemon nothing waits. `arpd.relay.link_queue` is the queue of an end, in which messages cross in chunks.

    Notes
    -----
    Not thread-safe. Times are seconds of one monotonic clock.
    """

    _heartbeat_s = HEARTBEAT_S  # of its writers
    _way_s = -math.inf  # until when large messages make way

    def __init__(self) -> None:
        self._lanes: dict[Lane, None] = {}
        self._active: dict[Lane, None] = {}  # with something to send, the longest active first
        self._virtual = 0.0
        self.sent_bytes = 0  # on the link
        self._debt = Debt()
        self._slowest = math.inf  # capacity since a fade ended (bytes/s)
        self._price: Price | None = None
        self._unplanned_s = -math.inf  # when a large sample without a plan may leave
        self._is_settled = True  # price and share belong to what the lanes have

    def __len__(self) -> int:
        return len(self._lanes)

    def add(self, lane: Lane) -> None:
        """Serve a lane from now on."""
        self._lanes[lane] = None

    def remove(self, lane: Lane) -> None:
        """Serve it no more, if it is served; what waits is withheld."""
        lane.close()
        self._lanes.pop(lane, None)
        self._active.pop(lane, None)
        self._is_settled = False

    def retune(self, lane: Lane, plan: TopicPlan, price: Price | None) -> None:
        """Give a lane its plan and the price; None = no daemon is there."""
        lane.retune(plan, price)
        self._is_settled = False

    def offer(
        self, lane: Lane, message: bytes, now_s: float, *, source: Hashable = None, expires_s: float = math.inf
    ) -> None:
        """Let a message wait for its turn; `Lane.offer` explains the arguments."""
        is_held_up, is_out = not self._is_open(now_s), self._is_out(now_s)
        expires_s = min(expires_s, now_s + lane.lifespan_s)
        lane.offer(message, now_s, source=source, expires_s=expires_s, is_held_up=is_held_up, is_out=is_out)
        if lane not in self._active:
            self._active[lane] = None
            lane.start = max(lane.start, self._virtual)

    def take(self, now_s: float) -> Ready | None:
        """Return what leaves now; it then counts as sent."""
        if not self._active or not self._is_open(now_s):
            return None
        self._settle(now_s)
        while (chosen := self._choose(now_s)) is not None:
            lane, is_first = chosen
            try:
                ready = self._leave(lane, now_s, is_first=is_first)
            except Exception:
                self._give_up(lane)
                raise
            if ready is not None:
                return ready
        return None

    def drop_faulty(self, now_s: float) -> None:
        """Withhold what waits of the lanes that raise when they are asked: no other one would have its turn."""
        for lane in tuple(self._active):
            try:
                _ = lane.first_s(now_s), lane.spare_s(now_s), lane.behind_s, lane.link_share
                _ = lane.left_bytes / lane.weight
            except Exception:  # noqa: BLE001 - whatever it is, it must not stop the others
                self._give_up(lane)

    def admit(self, lane: Lane, message: bytes, now_s: float) -> bool:
        """Let a small message pass at once where nothing keeps it; return whether it did, and then counts as sent.

        For samples that cross whole: what `offer` and `take_of` would do, in a fraction of their time.
        """
        if len(message) > SMALL_BYTES or lane.claimant is not None or not lane.admit(message, now_s):
            return False
        self._settle(now_s)
        if self._price is not None:
            self._drain(now_s)
            self._debt.owe(self._price.cost_s(lane.plan), most_s=MOST_SMALL_DEBT_S)
        return True

    def take_of(self, lane: Lane, now_s: float) -> bytes | None:
        """Return what leaves now of this lane, if it is its turn; it then counts as sent."""
        if lane.claimant is not None or lane not in self._active or not self._is_open(now_s):
            return None
        self._settle(now_s)
        is_first = lane.first_s(now_s) <= now_s
        if not is_first and ((chosen := self._choose(now_s)) is None or chosen[0] is not lane):
            return None
        return self._begin(lane, now_s, is_first=is_first)

    def rest_of(self, lane: Lane, now_s: float) -> list[bytes]:
        """Take all that waits of a lane, before its turn."""
        rest = []
        while lane in self._active:
            if (sample := self._begin(lane, now_s, is_first=False)) is not None:
                rest.append(sample)
        return rest

    def due_s(self, now_s: float) -> float:
        """Return when `take` may have something, ``inf`` = not before something changes (s)."""
        if not self._active or not self._is_open(now_s):
            return math.inf
        self._settle(now_s)
        first_s = self._first(now_s).due_s
        if first_s <= now_s or not self._has_room():
            return first_s
        turns = self._in_turn(now_s)
        return min(first_s, self._behind(turns).due_s, max(turns.due_s, self._free_s(now_s)))

    @property
    def is_waiting(self) -> bool:
        """Whether anything waits."""
        return bool(self._active)

    def _is_out(self, now_s: float) -> bool:  # noqa: ARG002 - the relay's queue needs it
        """Return whether the link has taken nothing for long."""
        return False

    def _is_open(self, now_s: float) -> bool:  # noqa: ARG002 - the relay's queue needs it
        """Return whether the link takes a small message."""
        return True

    def _has_room(self) -> bool:
        """Return whether it takes a part of a large one, too."""
        return True

    def _choose(self, now_s: float) -> tuple[Lane, bool] | None:
        """Return the lane whose turn it is, and whether it comes before large ones; None where nothing may leave."""
        if first := self._first(now_s).ready(now_s):
            return first[0], True
        if not self._has_room():
            return None
        turns = self._in_turn(now_s)
        ready = self._behind(turns).ready(now_s)
        if not ready and self._free_s(now_s) <= now_s + SOON_S:
            ready = turns.ready(now_s)
        return (min(ready, key=self._finish), False) if ready else None

    def _first(self, now_s: float) -> Times:
        """Return when the messages may leave that wait for no share of the link."""
        return Times((lane, lane.first_s(now_s)) for lane in self._active if lane.claimant is None)

    def _in_turn(self, now_s: float) -> Times:
        """Return when messages may leave that wait for a share of the link."""
        return Times(
            (lane, max(lane.due_s(now_s), self._unplanned_s if lane.link_share is None else -math.inf))
            for lane in self._active
            if lane.claimant is None
        )

    def _behind(self, turns: Times) -> Times:
        """Return when those of them may that are below their floor then, whatever has left before."""
        return Times((lane, max(due_s, lane.behind_s, self._way_s)) for lane, due_s in turns.items())

    def _finish(self, lane: Lane) -> float:
        """Return the virtual time at which the message of a lane ends, or so far of the rest that others may wait."""
        capacity = 0.0 if self._price is None else self._price.capacity_bytes_per_second
        return lane.start + min(_AHEAD * lane.left_bytes, _UNBROKEN_S * capacity) / lane.weight

    def _give_up(self, lane: Lane) -> None:
        lane.close(WithheldCause.FAILED)
        self.remove(lane)
        self.add(lane)

    def _leave(self, lane: Lane, now_s: float, *, is_first: bool) -> Ready | None:
        sample = self._begin(lane, now_s, is_first=is_first)
        return None if sample is None else Ready(lane, sample)

    def _begin(self, lane: Lane, now_s: float, *, is_first: bool) -> bytes | None:
        """Return the next part of a lane's message; None where all that waited had expired."""
        current = lane.current or lane.begin(now_s)
        if current is None:
            del self._active[lane]
            return None
        is_first = is_first and (len(current.message) <= SMALL_BYTES or now_s >= lane.unbound_s)
        part = self._cut(lane, current, now_s, is_first=is_first)
        self.sent_bytes += int(part.wire_bytes)
        self._count(lane, part, now_s, is_first=is_first)
        if current.offset >= len(current.message):
            self._end(lane, now_s)
        return part.sample

    def _cut(self, lane: Lane, current: UnderWay, now_s: float, *, is_first: bool) -> Part:  # noqa: ARG002 - as above
        """Return the next part of a message, which then counts as sent."""
        message = current.message
        current.offset = len(message)
        wire_bytes, packets = wire_size(len(message), rate_hz=math.inf)
        return Part(message, wire_bytes + self._asking_bytes(lane, now_s), packets)

    def _asking_bytes(self, lane: Lane, now_s: float) -> int:
        """Return what a writer takes that asks now for an acknowledgement, which goes the other way."""
        if now_s - lane.asked_s < self._heartbeat_s:
            return 0
        lane.asked_s = now_s
        self.sent_bytes += ACKNACK_BYTES
        return HEARTBEAT_BYTES

    def _count(self, lane: Lane, part: Part, now_s: float, *, is_first: bool) -> None:
        """Let a part take its share of the link."""
        price = self._price
        if not is_first:
            self._virtual = max(self._virtual, min([lane.start, *(each.start for each in self._active)]))
            lane.start += part.wire_bytes / lane.weight
        if price is not None and now_s < lane.unbound_s:
            cost_s = price.time_s(part.packets, part.wire_bytes)
            if lane.link_share is None and not is_first:
                self._unplanned_s = now_s + cost_s / max(LEAST_SHARE, price.spare_share)
            self._drain(now_s)
            self._debt.owe(cost_s, most_s=MOST_SMALL_DEBT_S if is_first else math.inf)

    def _end(self, lane: Lane, now_s: float) -> None:
        lane.ended(now_s)
        del self._active[lane]
        if len(lane):
            self._active[lane] = None  # behind the others

    def _drain(self, now_s: float) -> float:
        """Let the link time since the last call pass; return what is still to pass, below 0 for what it might have."""
        return self._debt.drain(now_s, self._drain_rate)

    def _free_s(self, now_s: float) -> float:
        """Return when its share of the link is free again (s)."""
        return self._way_s if self._price is None else max(self._way_s, self._debt.paid_s(now_s, self._drain_rate))

    @property
    def _drain_rate(self) -> float:
        return MOST_SHARE

    def _settle(self, now_s: float) -> None:
        """Follow the price and the plans of the lanes."""
        if self._is_settled:
            return
        self._is_settled = True
        self._price = next((lane.price for lane in self._lanes if lane.price is not None), None)
        if self._price is None:
            return
        capacity = self._price.capacity_bytes_per_second
        if capacity > _FADE * self._slowest:
            # What is still to pass are bytes: of a picture that left in a fade, minutes then and a moment now.
            self._debt.time_s = self._drain(now_s) * self._slowest / capacity
            self._slowest = capacity
        self._slowest = min(self._slowest, capacity)
