"""The flow of one AdaptivePublisher, from its lane in the paced queue to the writer: pure, over any kind of writer."""

from __future__ import annotations

import math
from collections import Counter, deque
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from arpd.endpoint.lane import CATCH_UP, SMALL_BYTES, Lane
from arpd.endpoint.slow_start import POLL_S, SlowStart
from arpd.endpoint.writer_swap import SwapTiming, WriterSwap
from arpd.model.endpoints import FlowState, Overflow, SwapResult, WithheldCause, Writer, WriterQos

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

_LEAST_FLOWING_HZ = 10.0  # of samples that a swap held
# A first plan takes about 2.5 s: a snapshot, the governor's debounce and the message of the plan.
_PATIENCE_S = 4.0
_NO_LOCK = nullcontext()
W = TypeVar("W", bound=Writer)


class Flow(Generic[W]):
    """Writes the samples that its lane releases by the current writer, and swaps that writer when its QoS shall change.

    Until the lane has a plan it behaves as a plain publisher: unpaced, with the QoS it was made with. One exception:
    large samples begin slowly (`SlowStart`), and while a daemon is there and has no plan for the topic yet, they wait
    some seconds for what is spare.

    Parameters
    ----------
    qos : QoS of the first writer
    overflow : which samples are withheld when they come faster than they may leave
    clock : monotonic clock (s)
    on_swap : called with the result of every swap and the QoS it was about
    on_held : called when a swap holds samples, so that `service` is due soon
    lock : may be taken again by the thread that has it; needed where several threads call

    Attributes
    ----------
    lane : its place in the queue, which the owner adds there
    swap : has the writer by which samples leave, and its QoS; the lock guards it
    start : of a topic that nobody has planned yet

    Notes
    -----
    Any thread may call `request` and `state`. Only one at a time may call `write` and `service`: the one that has
    claimed the lane.
    """

    def __init__(
        self,
        *,
        create: Callable[[WriterQos], W],
        qos: WriterQos,
        overflow: Overflow,
        clock: Callable[[], float],
        on_swap: Callable[[SwapResult, WriterQos], None] = lambda _result, _qos: None,
        on_held: Callable[[], None] = lambda: None,
        timing: SwapTiming | None = None,
        lock: AbstractContextManager[Any] = _NO_LOCK,
    ) -> None:
        self._clock = clock
        self._on_swap, self._on_held = on_swap, on_held
        self._swaps: Counter[str] = Counter()
        self.swap = WriterSwap(create=create, on_result=self._on_result, qos=qos, timing=timing)
        self._writer, self._awaits_silence = self.swap.current, False  # of the swap; only its steps change them
        self.lock = lock
        is_ordered = overflow is Overflow.QUEUE
        self.lane = Lane(
            self.write,
            depth=qos.depth if is_ordered else 1,
            large_depth=qos.depth if is_ordered else 1,
            is_ordered=is_ordered,
            patience_s=0.0 if is_ordered else _PATIENCE_S,
        )
        self.lane.plan = replace(self.lane.plan, deadline_ns=qos.deadline_ns, depth=qos.depth)
        self.start = SlowStart(self.lane, self._has_arrived, depth=qos.depth, is_off=is_ordered)
        self._withheld: Counter[str] = Counter()  # behind the queue, by cause
        # Of the writers before, less those of this one until it was in force.
        self._missed = -self._writer.deadlines_missed()
        self._held: deque[bytes] = deque()  # samples that the queue released and a swap holds
        self._catch_up_s = -math.inf  # when the next of them may leave

    def write(self, sample: bytes) -> None:
        """Write a sample that the queue released, or hold it while a swap says so; may block on a full link."""
        start = self.start
        if start.is_off or (len(sample) <= SMALL_BYTES and not start.waiting):
            self._pass(sample)
            return
        self._withheld[WithheldCause.BLOCKED.value] += start.offer(sample, self._clock())
        self._begin()
        if start.waiting:
            self._on_held()

    def _pass(self, sample: bytes) -> None:
        if not (self._held or self._awaits_silence):  # the usual case
            self._write(sample)
            return
        self._held.append(sample)
        if self._awaits_silence:  # the sample before is most likely acknowledged just now, so most swaps hold none
            self._step(self._clock())
        self._release()
        if self._held:
            self._on_held()

    def request(self, qos: WriterQos) -> None:
        """Ask for a writer with this QoS, which a swap brings; the plan's rates are the queue's to give."""
        with self.lock:
            self.swap.request(qos)

    def service(self, now_s: float) -> float:
        """Take a step of the swap, and write what it held; return when to call again, inf = when asked (s)."""
        if not (self.swap.is_busy or self._held or self.start.waiting):
            return math.inf
        self._step(now_s)
        self._release()
        self._begin()
        now_s = self._clock()
        due_s = now_s + self.swap.poll_s if self.swap.is_busy else math.inf
        if self.start.waiting:
            due_s = min(due_s, now_s + POLL_S)
        if self._held and not self.swap.is_holding:
            due_s = min(due_s, max(now_s, self._catch_up_s))
        return due_s

    def is_acknowledged(self) -> bool:
        """Return whether no sample waits here, and no reader waits for one."""
        if len(self.lane) or self.lane.claimant is not None or self._held or self.start.waiting:
            return False
        return self._has_arrived()

    def state(self) -> FlowState:
        """Return the settings in force and the counters; called about once a second."""
        lane = self.lane.state(self._clock())
        withheld = Counter(lane.withheld_by_cause) + self._withheld
        waiting = len(self._held) + len(self.start.waiting)
        with self.lock:
            return replace(
                lane,
                published=lane.published - self._withheld.total() - waiting,
                withheld=withheld.total(),
                withheld_by_cause=dict(withheld),
                queued=lane.queued + waiting,
                depth=self.swap.qos.depth,
                deadline_ns=self.swap.qos.deadline_ns,
                deadlines_missed=self._missed + self._writer.deadlines_missed(),
                swaps_by_result=dict(self._swaps),
                swaps_begun=self.swap.begun,
                last_swap=self.swap.last,
            )

    def rest(self) -> list[bytes]:
        """Take the samples that have left the queue and are not written yet, the oldest first."""
        rest = [*self._held, *self.start.waiting]
        self._held.clear()
        self.start.waiting.clear()
        return rest

    def close(self) -> None:
        """Withhold the samples that wait behind the queue, and destroy every writer."""
        with self.lock:
            self._withheld[WithheldCause.CLOSED.value] += len(self.rest())
            self.swap.close()

    def _has_arrived(self) -> bool:
        with self.lock:
            return self.swap.is_acknowledged()

    def _begin(self) -> None:
        """Write what the start of the topic lets go."""
        while (sample := self.start.take(self._clock())) is not None:
            self._pass(sample)

    def _write(self, sample: bytes) -> None:
        try:
            self._writer.publish(sample)
        except Exception:
            self._withheld[WithheldCause.FAILED.value] += 1  # it has left the queue and reached no reader
            raise
        if self._awaits_silence:
            with self.lock:
                self.swap.wrote(self._clock())

    def _step(self, now_s: float) -> None:
        with self.lock:
            before, price = self._writer, self.lane.price
            self.swap.loss_ratio = None if price is None else price.loss_ratio
            try:
                self.swap.step(now_s)
            finally:
                self._writer, self._awaits_silence = self.swap.current, self.swap.awaits_silence
            if self._writer is not before:
                self._missed += before.deadlines_missed() - self._writer.deadlines_missed()

    def _release(self) -> None:
        """Write what a swap held, at twice the rate at which it came."""
        while self._held and not self.swap.is_holding and (now_s := self._clock()) >= self._catch_up_s:
            spacing_s = 1.0 / (CATCH_UP * max(_LEAST_FLOWING_HZ, self._flowing_hz(now_s)))
            # A caller that comes late may write two more.
            self._catch_up_s = max(self._catch_up_s, now_s - 2.0 * spacing_s) + spacing_s
            self._write(self._held.popleft())
            if self._awaits_silence and self._held:
                self._step(now_s)

    def _flowing_hz(self, now_s: float) -> float:
        """Return the rate at which samples leave when no swap holds them, as far as it is known."""
        rate_hz, source_hz = self.lane.rate_hz, self.lane.offered_rate.rate_hz(now_s)
        return min(rate_hz, source_hz) if source_hz > 0 else rate_hz

    def _on_result(self, result: SwapResult, qos: WriterQos) -> None:
        self._swaps[result.value] += 1
        self._on_swap(result, qos)
