"""What waits of one topic for its turn on the link: pure."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from arpd.endpoint.meters import SampleRate
from arpd.model.endpoints import FlowState, WithheldCause
from arpd.model.plan import TopicPlan
from arpd.model.wire import FRAGMENT_BYTES, SMALL_PACKETS

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.model.price import Price

_HEADER_BYTES = 64  # of a chunk: with it a small one is ten packets, too
#: A larger message waits for its share of the link; where both ends are arpd's it crosses in chunks.
SMALL_BYTES = SMALL_PACKETS * FRAGMENT_BYTES - _HEADER_BYTES
_PACKET_BYTES = FRAGMENT_BYTES - _HEADER_BYTES
_LEAST_BURST, _BURST_S = 2.0, 0.3  # of a bucket: samples, and time of its rate; several nodes may publish at once
_UNPACED_BURST, _MOST_BRIEFLY = 10.0, 1000.0  # samples that may wait where no rate is set, and in a dip
_BRIEFLY_S = 0.01  # from one departure of small samples to the next, with company and a chunk before them
#: Times its usual rate at which leaves what has waited; a burst would crowd the link, and overrun readers.
CATCH_UP = 2.0
_AT_ONCE_S, _LATE_S = 0.5, 0.1  # below its floor: of the link for one message, and so much sooner comes the next
_DIP_S, _CALM_S = 0.25, 1.0  # a rate too little for so long costs no small sample, if none was lost for so long
_JUST_S = 2.0  # more than the last chunks and their acknowledgement take
_UNPLANNED = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=1)
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0  # its multiples fill 0..1 evenly and repeat nothing


class _Bucket:
    """Credit in samples, which a rate fills."""

    def __init__(self) -> None:
        self.rate_hz = math.inf
        self._most = self._credit = _LEAST_BURST
        self._at_s = -math.inf

    def retune(self, rate_hz: float, *, usual_hz: float) -> None:
        """Take the rate, and of which one some time may leave at once (Hz)."""
        self.rate_hz, self._most = rate_hz, max(_LEAST_BURST, _BURST_S * min(rate_hz, usual_hz))

    def due_s(self, now_s: float) -> float:
        """Return when there is credit for a sample (s)."""
        if self.rate_hz <= 0.0:
            return math.inf
        if self.credit(now_s) >= 1.0 - 1e-9:
            return now_s
        return now_s + (1.0 - self._credit) / self.rate_hz

    def credit(self, now_s: float) -> float:
        """Return how many samples may leave at once."""
        if math.isinf(self.rate_hz):
            return _UNPACED_BURST
        elapsed_s, self._at_s = max(0.0, now_s - self._at_s), max(now_s, self._at_s)
        gained = self.rate_hz * elapsed_s if elapsed_s < math.inf else self._most
        self._credit = min(self._most, self._credit + gained)
        return self._credit

    def spend(self, samples: float) -> None:
        """Take credit, of which some may be lacking; without a rate none is needed."""
        if self.rate_hz < math.inf:
            least = min(self._credit, -max(_LEAST_BURST, samples))  # a large charge counts whole
            self._credit = max(least, self._credit - samples)


class _Waiting(NamedTuple):
    source: Hashable
    message: bytes
    expires_s: float


@dataclass(slots=True)
class UnderWay:
    """The message of a lane that is being sent."""

    source: Hashable
    message: bytes
    number: int = 0  # of its first chunk, which names it
    offset: int = 0
    is_freight: bool = False


class Lane:
    """One topic on the link: what waits, and the rates that its plan and the price leave it.

    The sample that leaves is chosen when its turn comes: the newest of its source, and the sources take turns.

    Parameters
    ----------
    depth, large_depth : most small samples that wait of each source, and most large ones
    is_ordered : whether all sources wait in one line, ``depth`` samples long, until a plan says how long
    least_depth : most samples of that line where a plan says fewer
    is_kept : whether the other end delivers its samples however old they are
    weight : without a plan
    patience_s : longest wait of large samples for a first plan, which a topic that stays on its host never gets (s)
    has_company : whether its messages leave together with those of other topics where all are small

    Attributes
    ----------
    claimant : thread that is at its writer, so that no other one may be; the owner of the threads sets it
    is_closing : whether nobody may publish any more; the same owner sets it
    blocked_s : time inside its writer, which the same owner counts (s)
    may_be_freight : whether its messages may leave on a writer of several topics; its queue sets it
    lifespan_s : LIFESPAN of its writer, where all messages are of one; its owner sets it (s)
    """

    def __init__(
        self,
        write: Callable[[bytes], None],
        *,
        depth: int = 1,
        large_depth: int = 1,
        least_depth: int = 1,
        is_ordered: bool = False,
        is_kept: bool = False,
        weight: float = 1.0,
        patience_s: float = math.inf,
        has_company: bool = False,
    ) -> None:
        self.write, self.has_company = write, has_company
        self._depth, self._large_depth, self._least_depth = depth, large_depth, least_depth
        self._is_ordered, self.is_kept = is_ordered, is_kept
        self._weight, self._patience_s = weight, patience_s
        self._begun_waiting_s = math.inf  # when its first sample came while a daemon was there
        self.claimant: int | None = None
        self.is_closing = self.may_be_freight = False
        self.blocked_s = 0.0
        self._lines: dict[Hashable, deque[_Waiting]] = {}  # of each source that waits; the first one's turn is next
        self._cap, self._allowed = _Bucket(), _Bucket()
        self.rate_hz = math.inf
        self._brief_depth, self._dip_depth = 1, int(_MOST_BRIEFLY)  # small samples that may wait always, and in a dip
        self._is_thinned, self._thinned = False, 0
        self._short_s = self._dip_s = -math.inf  # when its rate cost a small sample last, and since when more waits
        self._before_s = self._begun_s = 0.0  # when the last message but one began, and the last, or should have
        self._floor_s = self.lifespan_s = math.inf
        self.plan = _UNPLANNED
        self.price: Price | None = None
        self.current: UnderWay | None = None
        self._last: tuple[Hashable, float] = (None, -math.inf)  # source of the message that left last, and when
        self.asked_s = -math.inf  # when its writer asked for an acknowledgement last
        self.start = 0.0  # virtual time of fair queueing
        self.offered_rate, self.sent_rate = SampleRate(), SampleRate()
        self.withheld: Counter[str] = Counter()  # by cause
        self.payload_bytes = 0.0

    def __len__(self) -> int:
        return sum(map(len, self._lines.values()))

    @property
    def weight(self) -> float:
        """Share of the link relative to other lanes."""
        return self.plan.weight if self.plan.weight > 0.0 else self._weight

    @property
    def link_share(self) -> float | None:
        """Share of the link time that its rate takes at the price; None where a topic with samples has no plan yet."""
        if self.price is None:
            return 0.0
        if self.plan.wire_bytes > 0.0:
            return self.rate_hz * self.price.cost_s(self.plan)
        return None if self.offered_rate.samples else 0.0

    def may_conflate(self, message: bytes) -> bool:
        """Return whether a message waits for its share of the link, where a newer one may replace it."""
        return len(message) > SMALL_BYTES and self.price is not None and not self._is_ordered

    @property
    def is_small(self) -> bool:
        """Whether the next message leaves whole, before all large ones; without a plan, one packet does."""
        return self.current is None and self.next_bytes <= (_PACKET_BYTES if self.link_share is None else SMALL_BYTES)

    @property
    def next_bytes(self) -> int:
        """Size of the message whose turn is next."""
        return len(self._next[1][0].message)

    @property
    def left_bytes(self) -> int:
        """Size of what is left of the message under way, or of the next one."""
        return self.next_bytes if self.current is None else len(self.current.message) - self.current.offset

    @property
    def unbound_s(self) -> float:
        """When its wait for a plan ends without one: it then needs no share of the link (s)."""
        return math.inf if self.plan.wire_bytes > 0.0 else self._begun_waiting_s + self._patience_s

    def retune(self, plan: TopicPlan, price: Price | None) -> None:
        """Take a plan and a price; None = no daemon is there."""
        self.plan, self.price = plan, price
        self.rate_hz = allowed_hz = plan.rate_hz if price is None else price.rate_hz(plan)
        growing_hz = plan.rate_hz if price is None else price.growing_hz(plan)
        if self._is_ordered:
            self._depth = self._large_depth = max(plan.depth, self._least_depth)
            cap_hz = max(plan.rate_hz, min(max(CATCH_UP * plan.rate_hz, growing_hz), plan.max_rate_hz))
            allowed_hz = allowed_hz if allowed_hz < plan.rate_hz else cap_hz
        else:
            cap_hz = plan.max_rate_hz if plan.weight > 0.0 or self.is_kept else plan.rate_hz
            allowed_hz = growing_hz
        self._cap.retune(cap_hz, usual_hz=plan.rate_hz)
        self._allowed.retune(allowed_hz, usual_hz=allowed_hz)
        self._dip_depth = int(min(_MOST_BRIEFLY, max(_LEAST_BURST, _BURST_S * cap_hz)))
        self._brief_depth = int(min(_UNPACED_BURST, 1.0 + _BRIEFLY_S * plan.rate_hz))
        floor_hz = plan.min_rate_hz if price is None else price.floor_hz(plan)
        self._floor_s = 1.0 / floor_hz if floor_hz > 0.0 else math.inf

    def offer(
        self,
        message: bytes,
        now_s: float,
        *,
        source: Hashable = None,
        expires_s: float = math.inf,
        is_held_up: bool = False,
        is_out: bool = False,
    ) -> None:
        """Take a message.

        Parameters
        ----------
        source : its writer
        expires_s : when nobody wants it any more (s)
        is_held_up : whether the link takes nothing now, so that no rate is the cause of what is withheld
        is_out : whether that has lasted so long that the newest of a source is all that is wanted
        """
        self._note(message, now_s)
        line = self._lines.setdefault(None if self._is_ordered else source, deque())
        line.append(_Waiting(source, message, expires_s))
        if len(line) == 1:
            if len(self._lines) == 1:
                self._dip_s = -math.inf  # all that waited has left
            return
        most = self._depth if len(message) <= SMALL_BYTES else self._large_depth
        if self.is_kept and not self._is_ordered and self._cap.due_s(now_s) > now_s:
            most = 1  # its source is faster than its configured rate, so what waits would only grow
        if most == 1 and not is_out and all(len(each.message) <= SMALL_BYTES for each in line):
            most = self._most_small(len(line), now_s, is_held_up=is_held_up)
        while len(line) > most:
            line.popleft()
            self._is_thinned = True
            self.withheld[self._cause(is_held_up=is_held_up).value] += 1

    def admit(self, message: bytes, now_s: float) -> bool:
        """Let a message pass at once where none waits and the rates allow it; return whether it did."""
        if self._lines or self.current is not None or self.due_s(now_s) > now_s:
            return False
        self._note(message, now_s)
        self._cap.spend(1.0)
        self._allowed.spend(1.0)
        self._begun_s = now_s
        self.sent_rate.count(now_s)
        return True

    def due_s(self, now_s: float) -> float:
        """Return when the next message may begin by its allowed rate (s)."""
        return max(self._cap.due_s(now_s), self._allowed.due_s(now_s))

    def first_s(self, now_s: float) -> float:
        """Return when it may leave before those that wait for a share of the link (s)."""
        return self.due_s(now_s) if self.is_small else max(self.due_s(now_s), self.unbound_s)

    def spare_s(self, now_s: float) -> float:
        """Return when it may leave if the link has time to spare: by its cap, or at once if it is under way (s)."""
        return self._cap.due_s(now_s) if self.current is None else -math.inf

    @property
    def behind_s(self) -> float:
        """When the topic is below its floor, unless its message has left by then (s).

        A large message may catch up for a moment; what is left of it then comes at its floor.
        """
        if self.current is None or math.isinf(self._floor_s):
            return self._begun_s + self._floor_s
        capacity = math.inf if self.price is None else self.price.capacity_bytes_per_second
        beyond = max(0.0, self.current.offset - _AT_ONCE_S * capacity) / len(self.current.message)
        return max(self._before_s + self._floor_s, self._begun_s) + beyond * self._floor_s

    def has(self, source: Hashable, now_s: float) -> bool:
        """Return whether a message of this source waits, is on its way, or was just now."""
        if source in self._lines or (self.current is not None and self.current.source == source):
            return True
        return self._last[0] == source and now_s - self._last[1] < _JUST_S

    def begin(self, now_s: float) -> UnderWay | None:
        """Take the next message for sending; None where all that waited had expired."""
        while self._lines:
            key, line = self._next
            del self._lines[key]
            waiting = line.popleft()
            if line:
                self._lines[key] = line  # behind the other sources
            if waiting.expires_s <= now_s:
                self.withheld[WithheldCause.BLOCKED.value] += 1
                continue
            # What the price thins out is not always each second one: a source may alternate between two things.
            self._thinned += self._is_thinned
            spent = 0.5 + self._thinned * _GOLDEN % 1.0 if self._is_thinned else 1.0
            self._is_thinned = False
            self._cap.spend(spent)
            self._allowed.spend(spent)
            self._before_s = self._begun_s
            self._begun_s = min(now_s, max(self._before_s + self._floor_s, now_s - _LATE_S))
            self.current = UnderWay(waiting.source, waiting.message)
            return self.current
        return None

    def charge(self, packets: float, wire_bytes: float) -> None:
        """Take credit for what a small message took more of the link than planned, or give it back.

        Where all topics have one rate, the terms of a plan are nominal, without packets.
        """
        if self.price is not None and self.plan.packets:
            self._allowed.spend(self.price.time_s(packets, wire_bytes) / self.price.cost_s(self.plan) - 1.0)

    def ended(self, now_s: float) -> None:
        """Note that the message under way has left."""
        if self.current is not None:
            self._last = self.current.source, now_s
        self.current = None
        self.sent_rate.count(now_s)

    def give_up_old(self) -> None:
        """Give up what has become old in an outage: all but the newest of a source."""
        if self.is_kept:
            return
        for line in self._lines.values():
            while len(line) > self._depth:
                line.popleft()
                self.withheld[WithheldCause.BLOCKED.value] += 1
        if self.current is not None and self.current.source in self._lines:
            self.withheld[WithheldCause.BLOCKED.value] += 1
            self.current = None

    def state(self, now_s: float) -> FlowState:
        """Return the settings in force and the counters; called about once a second."""
        rates = [meter.rate_hz(now_s) for meter in (self.offered_rate, self.sent_rate)]
        self.offered_rate.mark(now_s)
        self.sent_rate.mark(now_s)
        withheld, plan = dict(self.withheld), self.plan
        return FlowState(
            payload_bytes=self.payload_bytes,
            source_rate_hz=rates[0],
            published_rate_hz=rates[1],
            offered=self.offered_rate.samples,
            published=self.sent_rate.samples,
            withheld=sum(withheld.values()),
            withheld_by_cause=withheld,
            queued=len(self),
            blocked_s=self.blocked_s,
            rate_hz=plan.rate_hz,
            paced_rate_hz=self.rate_hz,
            depth=plan.depth,
            deadline_ns=plan.deadline_ns,
        )

    def close(self, cause: WithheldCause = WithheldCause.CLOSED) -> None:
        """Withhold all that waits."""
        self.withheld[cause.value] += len(self) + (self.current is not None)
        self._lines.clear()
        self.current = None

    def _note(self, message: bytes, now_s: float) -> None:
        self.offered_rate.count(now_s)
        self.payload_bytes += (0.1 if self.payload_bytes else 1.0) * (len(message) - self.payload_bytes)
        if self.price is not None:
            self._begun_waiting_s = min(self._begun_waiting_s, now_s)

    def _most_small(self, waiting: int, now_s: float, *, is_held_up: bool) -> int:
        """Return how many small samples of a source may wait.

        Within its rate a sample waits for no more than the thread that writes it and the link's next room; and in a dip
        of the rate, as after a fall of the link, until it is over. The next dip begins when all that waited has left.
        Without a rate all leave at once, but not on a link that is full of them: then the newest waits.
        """
        is_full = is_held_up and math.isinf(self.plan.rate_hz)
        credit = min(self._cap.credit(now_s), self._allowed.credit(now_s))
        most = 1 if is_full else max(self._brief_depth, int(credit))
        if waiting > most:
            if self._dip_s == -math.inf and now_s - self._short_s > _CALM_S:
                self._dip_s = now_s
            if now_s - self._dip_s < _DIP_S:
                most = max(most, self._dip_depth)
            if waiting > most:
                self._short_s = now_s
        return most

    @property
    def _next(self) -> tuple[Hashable, deque[_Waiting]]:
        return next(iter(self._lines.items()))

    def _cause(self, *, is_held_up: bool) -> WithheldCause:
        if is_held_up or self.claimant is not None or math.isinf(self._allowed.rate_hz):
            return WithheldCause.BLOCKED
        return WithheldCause.PRICE if self._allowed.rate_hz < self.plan.rate_hz else WithheldCause.RATE
