"""The flow of one AdaptivePublisher, from its lane in the paced queue to the writer: pure, over any kind of writer."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.slow_start import POLL_S, SlowStart
from arpd.endpoint.writer_swap import WriterSwap
from arpd.model.endpoints import FlowState, Overflow, SwapResult, SwapTiming, WithheldCause, Writer, WriterQos

if TYPE_CHECKING:
    from collections.abc import Callable

# A first plan takes about 2.5 s: a snapshot, the governor's debounce and the message of the plan.
_PATIENCE_S = 4.0
_NO_LOCK = nullcontext()
W = TypeVar("W", bound=Writer)


class Flow(Generic[W]):
    """Writes the samples that its lane releases, and counts them all.

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
    lock : as that of `WriterSwap`

    Attributes
    ----------
    lane : its place in the queue, which the owner adds there
    swap : has the writer by which samples leave, and its QoS
    start : of a topic that nobody has planned yet

    Notes
    -----
    Any thread may call `state`. Only one at a time may call `write` and `service`: the one that has claimed the lane.
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
        self.swap = WriterSwap(
            create=create,
            on_result=self._on_result,
            qos=qos,
            clock=clock,
            on_held=on_held,
            timing=timing,
            lock=lock,
        )
        is_ordered = overflow is Overflow.QUEUE
        self.lane = Lane(
            self.write,
            depth=qos.depth if is_ordered else 1,
            large_depth=qos.depth if is_ordered else 1,
            is_ordered=is_ordered,
            patience_s=0.0 if is_ordered else _PATIENCE_S,
        )
        self.lane.plan = replace(self.lane.plan, deadline_ns=qos.deadline_ns, depth=qos.depth)
        self.start = SlowStart(self.lane, self.swap.is_acknowledged, depth=qos.depth, is_off=is_ordered)
        self._withheld: Counter[str] = Counter()  # behind the queue, by cause

    def write(self, sample: bytes) -> None:
        """Write a sample that the queue released, or hold it while a swap says so; may block on a full link."""
        start = self.start
        if start.is_off or (len(sample) <= SMALL_BYTES and not start.waiting):
            self.swap.write(sample)
            return
        self._withheld[WithheldCause.BLOCKED.value] += start.offer(sample, self._clock())
        self._begin()
        if start.waiting:
            self._on_held()

    def service(self, now_s: float) -> float:
        """Take a step of the swap, and write what it held; return when to call again, inf = when asked (s)."""
        price = self.lane.price
        self.swap.loss_ratio = None if price is None else price.loss_ratio
        if self.swap.is_busy:
            self.swap.step(now_s)
        self._begin()
        now_s = self._clock()
        return min(self.swap.due_s(now_s), now_s + POLL_S if self.start.waiting else math.inf)

    def is_acknowledged(self) -> bool:
        """Return whether no sample waits here, and no reader waits for one."""
        if len(self.lane) or self.lane.claimant is not None or self.start.waiting:
            return False
        return self.swap.is_acknowledged()

    def state(self) -> FlowState:
        """Return the settings in force and the counters; called about once a second."""
        lane = self.lane.state(self._clock())
        swap, waiting = self.swap, len(self.swap.held) + len(self.start.waiting)
        behind = self._withheld + Counter({WithheldCause.FAILED.value: swap.failed})
        withheld = Counter(lane.withheld_by_cause) + behind
        with swap.lock:
            return replace(
                lane,
                published=lane.published - behind.total() - waiting,
                withheld=withheld.total(),
                withheld_by_cause=dict(withheld),
                queued=lane.queued + waiting,
                depth=swap.qos.depth,
                deadline_ns=swap.qos.deadline_ns,
                deadlines_missed=swap.deadlines_missed(),
                swaps_by_result=dict(self._swaps),
                swaps_begun=swap.begun,
                last_swap=swap.last,
            )

    def rest(self) -> list[bytes]:
        """Take the samples that have left the queue and are not written yet, the oldest first."""
        rest = [*self.swap.rest(), *self.start.waiting]
        self.start.waiting.clear()
        return rest

    def close(self) -> None:
        """Withhold the samples that wait behind the queue, and destroy every writer."""
        self._withheld[WithheldCause.CLOSED.value] += len(self.rest())
        self.swap.close()

    def _begin(self) -> None:
        """Write what the start of the topic lets go."""
        while (sample := self.start.take(self._clock())) is not None:
            self.swap.write(sample)

    def _on_result(self, result: SwapResult, qos: WriterQos) -> None:
        self._swaps[result.value] += 1
        self._on_swap(result, qos)
