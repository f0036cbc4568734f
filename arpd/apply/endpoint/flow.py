"""The flow of one AdaptivePublisher, from the application's sample to the writer: pure, over any kind of writer."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import TYPE_CHECKING, Generic, TypeVar

from arpd.apply.endpoint.link_clock import LinkClock
from arpd.apply.endpoint.meters import DeadlineCount, SampleRate
from arpd.apply.endpoint.pacing import Pacer
from arpd.apply.endpoint.writer_swap import SwapTiming, WriterSwap
from arpd.model.endpoints import FlowState, SwapResult, WithheldCause, Writer, WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.settings import Overflow
from arpd.model.wire import FRAGMENT_BYTES, SMALL_PACKETS

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.price import Price

# Samples that a swap held leave at twice their rate. A burst would crowd the link, and push samples out of a small
# history of the writer or a reader.
_CATCH_UP = 0.5
_LEAST_CATCH_UP_HZ = 10.0
W = TypeVar("W", bound=Writer)


class Flow(Generic[W]):
    """Paces samples into the current writer, and swaps that writer when its QoS shall change.

    Until `retune` is called it behaves as a plain publisher: unpaced, with the QoS it was made with. One exception:
    while a daemon is there and has no plan for the topic yet, large samples wait for that plan (`SlowStart`).

    Parameters
    ----------
    create : makes a writer with the given QoS
    qos : QoS of the first writer
    overflow : which samples are withheld when they come faster than they may leave
    clock : monotonic clock (s)
    on_swap : called with the result of every swap and the QoS it was about
    timing : timeouts of a swap
    link : shared by all flows of the process; its own one sees only this flow

    Notes
    -----
    Not thread-safe, but `write` may run beside `offer`, `retune`, `set_price` and `state`. An owner with threads takes
    samples one by one under its lock and writes them outside it, because a writer may block when the link is full.
    """

    def __init__(
        self,
        *,
        create: Callable[[WriterQos], W],
        qos: WriterQos,
        overflow: Overflow,
        clock: Callable[[], float],
        on_swap: Callable[[SwapResult, WriterQos], None] = lambda _result, _qos: None,
        timing: SwapTiming | None = None,
        link: LinkClock | None = None,
    ) -> None:
        self._clock = clock
        self._link = link or LinkClock()
        self._ready_s: float | None = None  # since when a sample waits only for its turn on the link
        self._on_swap = on_swap
        self._swaps: Counter[str] = Counter()
        self._swap = WriterSwap(create=create, on_result=self._on_result, qos=qos, timing=timing)
        self._writer, self._awaits_silence = self._swap.current, False  # of the swap; only its steps change them
        self._may_conflate = overflow is Overflow.LATEST
        self._pacer = Pacer(overflow=overflow, depth=qos.depth, on_withheld=self._on_withheld)
        self._plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=qos.deadline_ns, depth=qos.depth)
        self._is_large = False  # its samples wait for their turn on the link
        self._price: Price | None = None
        self._slow_start = SlowStart()
        self._is_slow = False  # whether a slow start holds
        self._source, self._departures = SampleRate(), SampleRate()
        self._withheld: Counter[str] = Counter()  # by cause
        self._deadlines = DeadlineCount(self._swap.current)
        self._blocked_s = 0.0
        self._payload_bytes = 0.0
        self._held: deque[bytes] = deque()  # samples that pacing released and a swap holds
        self._catch_up_s = -math.inf  # when the next of them may leave
        self._history: deque[bytes] | None = None
        self._replay: deque[bytes] = deque()

    @property
    def plan(self) -> TopicPlan:
        """Settings requested last."""
        return self._plan

    @property
    def qos(self) -> WriterQos:
        """QoS of the writer by which samples leave."""
        return self._swap.qos

    @property
    def writer(self) -> W:
        """Writer by which samples leave."""
        return self._swap.current

    @property
    def offered(self) -> int:
        """Samples that the application gave so far."""
        return self._source.samples

    @property
    def payload_bytes(self) -> float:
        """Mean size of a sample, 0 before the first (bytes)."""
        return self._payload_bytes

    @property
    def is_waiting(self) -> bool:
        """True while samples wait, for pacing or for a swap."""
        return bool(len(self._pacer) or self._held)

    def publish(self, sample: bytes) -> None:
        """Send a sample, now or when pacing allows it."""
        self.offer(sample)
        self._release()

    def offer(self, sample: bytes) -> None:
        """Queue a sample; the owner calls `take` and `write`, or `service`, soon after."""
        now_s = self._clock()
        self._count(sample, now_s)
        self._pacer.offer(sample, now_s)

    def admit(self, sample: bytes) -> bool:
        """Return whether a sample may be written at once; if not, queue it as `offer` does."""
        now_s = self._clock()
        self._count(sample, now_s)
        if not (self._held or self._replay or self._awaits_silence) and (
            (not self._is_large or self._link.turn_s(self._plan, ready_s=now_s, now_s=now_s) <= now_s)
            and self._pacer.admits(now_s)
        ):
            return True
        self._pacer.offer(sample, now_s)
        return False

    def before_take(self) -> None:
        """Let a swap take its step just before a sample leaves; `replay` comes next."""
        # The previous sample is most likely acknowledged just then, so most swaps need not hold samples.
        if self._awaits_silence and self.is_waiting:
            self.step(self._clock())

    def take(self) -> bytes | None:
        """Return the next sample if pacing allows it now and no swap holds it."""
        now_s = self._clock()
        if not self._held and not self._swap.is_holding:
            if self._turn_s(now_s) > now_s:
                return None
            self._ready_s = None
            return self._pacer.take(now_s)
        # A swap holds samples behind the pacing, so it conflates none of them.
        sample = self._pacer.take(now_s)
        while sample is not None:
            self._held.append(sample)
            sample = self._pacer.take(now_s)
        if self._swap.is_holding or now_s < self._catch_up_s:
            return None
        spacing_s = _CATCH_UP / max(_LEAST_CATCH_UP_HZ, self._flowing_hz(now_s))
        # A caller that comes late may take two more.
        self._catch_up_s = max(self._catch_up_s, now_s - 2.0 * spacing_s) + spacing_s
        return self._held.popleft()

    def write(self, sample: bytes) -> float:
        """Write a sample that was taken or admitted; may block while the link's queue is full.

        Returns
        -------
        Time it took (s).
        """
        before_s = self._clock()
        try:
            self._writer.publish(sample)
        except Exception:
            self._on_withheld(1, WithheldCause.FAILED)  # it has left the queue and reached no reader
            raise
        after_s = self._clock()
        took_s = after_s - before_s
        self._blocked_s += took_s
        self._departures.count(after_s)
        if self._plan.wire_bytes:
            self._link.occupy(self._plan, after_s)
        if self._awaits_silence:
            self._swap.wrote(self._clock())
        if self._history is not None:
            self._history.append(sample)
        return took_s

    def keep_history(self) -> None:
        """Replay the old writer's samples by each new writer, for late readers of a TRANSIENT_LOCAL topic."""
        self._history = deque(maxlen=self.qos.depth)
        self._swap.needs_proof = False  # a reader that matches late gets all of them

    def replay(self) -> None:
        """Write the old writer's samples by the new one; may block like `write`, and comes before the next `take`."""
        while self._replay:
            self._writer.publish(self._replay.popleft())

    def retune(self, plan: TopicPlan, *, qos: WriterQos) -> None:
        """Take new settings: pacing changes now, depth and deadline by a swap.

        Parameters
        ----------
        plan : settings as requested
        qos : QoS for the writer, after clamps and refusals
        """
        now_s = self._clock()
        self._plan, self._is_large = plan, plan.packets > SMALL_PACKETS
        self._slow_start.end()
        self._pace(now_s)
        self._swap.request(qos)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link, from which the rate follows; None = no daemon is there."""
        now_s = self._clock()
        if price is not None:
            self._link.set_price(price, now_s)
        self._slow_start.has_daemon = price is not None
        self._swap.loss_ratio = None if price is None else price.loss_ratio
        if price != self._price or self._is_slow != self._slow_start.holds(now_s):
            self._price = price
            self._pace(now_s)

    def service(self, now_s: float) -> float:
        """Take a step of the swap, and write the samples that are due.

        Returns
        -------
        Time of the next call, ``inf`` = not before something changes (s).
        """
        if not (self._swap.is_busy or self._replay or self.is_waiting):
            return math.inf
        self.step(now_s)
        self._release()
        return self.due_s(now_s)

    def step(self, now_s: float) -> None:
        """Move a swap on as far as its writers allow."""
        if not self._swap.is_busy:
            return
        before = self._writer
        try:
            self._swap.step(now_s)
        finally:
            self._writer, self._awaits_silence = self._swap.current, self._swap.awaits_silence
        if self._writer is before:
            return
        self._deadlines.follow(self._writer)
        if self._history is not None:
            self._replay = deque(self._history)
            self._history = deque(self._history, maxlen=self._swap.qos.depth)

    def due_s(self, now_s: float) -> float:
        """Return when to call `service` again, ``inf`` = not before something changes (s)."""
        due_s = self._turn_s(now_s)
        if self._held and not self._swap.is_holding:
            due_s = min(due_s, max(now_s, self._catch_up_s))
        return min(due_s, now_s + self._swap.poll_s) if self._swap.is_busy else due_s

    def state(self) -> FlowState:
        """Return the settings in force and the counters; called about once a second."""
        now_s = self._clock()
        rate_hz, published_rate_hz = self._source.rate_hz(now_s), self._departures.rate_hz(now_s)
        self._source.mark(now_s)
        self._departures.mark(now_s)
        withheld, ledger = dict(self._withheld), self._swap.ledger
        return FlowState(
            payload_bytes=self._payload_bytes,
            source_rate_hz=rate_hz,
            published_rate_hz=published_rate_hz,
            offered=self.offered,
            published=self._departures.samples,
            withheld=sum(withheld.values()),
            withheld_by_cause=withheld,
            queued=len(self._pacer) + len(self._held),
            blocked_s=self._blocked_s,
            rate_hz=self._plan.rate_hz,
            paced_rate_hz=self._pacer.rate_hz,
            depth=self.qos.depth,
            deadline_ns=self.qos.deadline_ns,
            deadlines_missed=self._deadlines.missed,
            swaps_by_result=dict(self._swaps),
            swaps_begun=ledger.begun,
            swap_seconds_by_phase=dict(ledger.seconds_by_phase),
            last_swap=ledger.last,
        )

    def close(self) -> None:
        """Withhold the samples that wait, and destroy every writer."""
        self._pacer.clear()
        if self._held:
            self._on_withheld(len(self._held), WithheldCause.CLOSED)
        self._held.clear()
        self._replay.clear()
        self._swap.close()

    def _release(self) -> None:
        self.before_take()
        self.replay()
        while self.is_waiting and (sample := self.take()) is not None:
            self.write(sample)

    def _turn_s(self, now_s: float) -> float:
        """Return when the next sample may leave by its pacing and by the link clock (s)."""
        if (due_s := self._pacer.due_s(now_s)) > now_s:
            self._ready_s = None
            return due_s
        if self._ready_s is None:
            self._ready_s = now_s
        return max(now_s, self._link.turn_s(self._plan, ready_s=self._ready_s, now_s=now_s))

    def _count(self, sample: bytes, now_s: float) -> None:
        self._source.count(now_s)
        if not self._payload_bytes and self._may_conflate:
            self._slow_start.begin(len(sample), now_s)
            self._pace(now_s)
        weight = 0.1 if self._payload_bytes else 1.0
        self._payload_bytes += weight * (len(sample) - self._payload_bytes)

    def _flowing_hz(self, now_s: float) -> float:
        """Return the rate at which samples leave when no swap holds them, as far as it is known."""
        rate_hz, source_hz = self._pacer.rate_hz, self._source.rate_hz(now_s)
        return min(rate_hz, source_hz) if source_hz > 0 else rate_hz

    def _pace(self, now_s: float) -> None:
        rate_hz = self._plan.rate_hz if self._price is None else self._price.rate_hz(self._plan)
        self._is_slow = self._slow_start.holds(now_s)
        if self._is_slow:
            rate_hz = min(rate_hz, SLOW_START_HZ)
        limit = WithheldCause.PRICE if rate_hz < self._plan.rate_hz else WithheldCause.RATE
        self._pacer.retune(rate_hz=rate_hz, depth=self._plan.depth, now_s=now_s, limit=limit)

    def _on_withheld(self, samples: int, cause: WithheldCause) -> None:
        self._withheld[cause.value] += samples

    def _on_result(self, result: SwapResult, qos: WriterQos) -> None:
        self._swaps[result.value] += 1
        self._on_swap(result, qos)


#: Rate of a topic of large samples until its first plan: two cameras, two lidars and a point cloud take 1 Mbit/s (Hz).
SLOW_START_HZ = 2.0
_LONGEST_S = 4.0  # a first plan takes about 2.5 s: an announcement, the governor's debounce and the message of the plan


class SlowStart:
    """Slows a topic until its first plan, as a TCP sender begins with a small window (RFC 5681 §3.1).

    The load of a new source is not known before some samples were counted. Until then a robot that starts its camera
    on a weak link would fill every queue. Only topics whose samples take more than one packet wait, only while a
    daemon is there to plan them, and for a limited time: a topic that stays on its host is never planned.
    """

    def __init__(self) -> None:
        self.has_daemon = False
        self._until_s: float | None = None  # None before the first sample
        self._is_large = False

    def begin(self, sample_bytes: int, now_s: float) -> None:
        """Note the first sample."""
        if self._until_s is None:
            self._until_s = now_s + _LONGEST_S
            self._is_large = sample_bytes > FRAGMENT_BYTES

    def end(self) -> None:
        """Note that there is a plan; no slow start follows."""
        self._until_s, self._is_large = 0.0, False

    def holds(self, now_s: float) -> bool:
        """Return whether the topic must wait."""
        return self.has_daemon and self._is_large and self._until_s is not None and now_s < self._until_s
