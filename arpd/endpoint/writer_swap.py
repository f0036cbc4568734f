"""The writer swap of one publisher, as a state machine (docs/design.md, The writer swap)."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from arpd.model.endpoints import SwapRecord, SwapResult, SwapState, SwapTiming, Writer, WriterQos
from arpd.model.wire import CLEAN_LOSS_RATIO

if TYPE_CHECKING:
    from collections.abc import Callable

_NO_LOCK = nullcontext()
W = TypeVar("W", bound=Writer)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Draining(Generic[W]):
    writer: W
    qos: WriterQos
    since_s: float


class WriterSwap(Generic[W]):
    """Writes by the writer in force of one publisher, and replaces that without losing a sample.

    docs/design.md has the states and their transitions. After a switch the old writer drains beside the new one. What
    a swap held leaves at twice the rate at which it came.

    Only the writer's side knows at once that it matched, so the new writer has to prove itself. On a lossy link the
    readers' side follows up to seconds later, and a small history would lose the samples of that time.

    Invariant: until `close`, ``current`` is always a live writer, and every sample is written exactly once. Only one
    thread at a time may call `write`, `step` and `rest`.

    Parameters
    ----------
    create : makes a writer with the given QoS; may raise
    on_result : called with the result of every swap and the QoS it was about
    qos : QoS of the first writer
    clock : monotonic clock (s)
    on_held : called when it holds samples, so that `step` is due soon
    lock : guards the writers, may be taken again by the thread that has it; needed where several threads call

    Attributes
    ----------
    current : writer by which samples leave; only a step changes it
    held : samples that wait for the swap, the oldest first, and when they came (s)
    failed : samples that the middleware refused
    begun : swaps so far; each has one result, and perhaps ``undelivered`` beside it, or is under way
    last : the swap that finished last, None before the first
    loss_ratio : share of packets that the link loses, None while unknown; the owner keeps it up to date
    """

    def __init__(
        self,
        *,
        create: Callable[[WriterQos], W],
        on_result: Callable[[SwapResult, WriterQos], None],
        qos: WriterQos,
        clock: Callable[[], float],
        on_held: Callable[[], None] = lambda: None,
        timing: SwapTiming | None = None,
        lock: AbstractContextManager[Any] = _NO_LOCK,
    ) -> None:
        self._create, self._on_result, self._on_held = create, on_result, on_held
        self._results: deque[tuple[SwapResult, WriterQos]] = deque()  # not told yet
        self._timing = timing or SwapTiming()
        self._clock, self.lock = clock, lock
        self._qos = qos
        self._current = self.current = create(qos)
        self._awaits_silence = False  # the state has to be looked at just before a sample leaves
        self.held: deque[tuple[bytes, float]] = deque()
        self._shift_s = -math.inf  # when one of them may leave, less half of the time when it came; -inf while none may
        # Of the writers before, less those of this one until it was in force.
        self._missed = -self.current.deadlines_missed()
        self._wanted: WriterQos | None = None
        self._next: W | None = None
        self._next_qos = qos
        self._created_s = self._watch_s = 0.0
        self._readers = (0, 0)  # of the current and the next writer, when last looked at
        self._readers_since_s = 0.0
        self._since_s = 0.0  # when the state was entered, or samples of it began to be held
        self._can_prove = False  # the readers acknowledge samples
        self._is_late = False  # switched with the old writer not fully acknowledged
        self._trial = 0  # samples that left by the new writer before it proved that they arrive
        self._is_proven = self._is_doubted = False
        self._draining: list[_Draining[W]] = []
        self._is_closed = False
        self.begun = self.failed = 0
        self.last: SwapRecord | None = None
        self._seconds: defaultdict[str, float] = defaultdict(float)  # in each state of the swap under way
        self._entered_s = -math.inf
        self.loss_ratio: float | None = None
        self.state = SwapState.IDLE

    @property
    def writers(self) -> list[W]:
        """All that live."""
        return [*filter(None, (self._current, self._next)), *(old.writer for old in self._draining)]

    @property
    def qos(self) -> WriterQos:
        """QoS of the current writer."""
        return self._next_qos if self.state is SwapState.PROVING else self._qos

    @property
    def is_busy(self) -> bool:
        """True while `step` has anything to do."""
        return self.state is not SwapState.IDLE or self._wanted is not None or bool(self._draining or self.held)

    @property
    def is_holding(self) -> bool:
        """True while new samples should wait."""
        if self.state is not SwapState.PROVING:
            return self.state is SwapState.HOLDING
        # So many samples may leave by the new writer before it proved itself; its history keeps them.
        return self._trial >= max(1, min(self._qos.depth, self._next_qos.depth) // 2)

    def due_s(self, now_s: float) -> float:
        """Return when `step` should be called again, inf = not before a request (s)."""
        if not self.is_busy:
            return math.inf
        if self.is_holding:
            return now_s + 0.002  # samples wait for it
        poll_s = 0.1
        if self.state is SwapState.MATCHING:
            # Each call costs a wakeup: one every 50 ms took 35 ms of CPU per swap on an idle topic.
            poll_s = min(0.05 if self._is_link_clean else 0.2, self._timing.settle_s / 4.0)
        return min(now_s + poll_s, max(now_s, self._shift_s + self.held[0][1] / 2.0)) if self.held else now_s + poll_s

    def request(self, qos: WriterQos) -> None:
        """Request new QoS; the newest request wins, and one that changes nothing is no swap."""
        with self.lock:
            if not self._is_closed:
                target = self._next_qos if self._next is not None else self._qos
                self._wanted = None if qos == target else qos

    def write(self, sample: bytes) -> None:
        """Write a sample, or hold it while a swap says so or others are held; may block on a full link."""
        if self.held or self._awaits_silence:
            self._hold(sample, self._clock())
            return
        try:  # the usual case
            self.current.publish(sample)
        except Exception:
            self.failed += 1  # it reached no reader
            raise

    def step(self, now_s: float) -> None:
        """Move on as far as the writers allow, and write what was held and may leave."""
        self._move(now_s)
        self._release(now_s)

    def rest(self) -> list[bytes]:
        """Take the samples that are held."""
        rest = [sample for sample, _ in self.held]
        self.held.clear()
        return rest

    def deadlines_missed(self) -> int:
        """Count the offered deadlines that the writers missed, each while it was in force."""
        return self._missed + self.current.deadlines_missed()

    def is_acknowledged(self) -> bool:
        """Return whether no sample is held, and no reader waits for one."""
        with self.lock:
            return not self.held and all(map(_is_served, self.writers))

    def close(self) -> None:
        """Destroy every writer, even when one of them raises; nothing happens after that."""
        with self.lock, ExitStack() as stack:
            if self._is_closed:
                return
            self._is_closed, self._wanted = True, None
            draining, self._draining = self._draining, []
            stack.callback(self._current.destroy)
            for old in draining:
                stack.callback(old.writer.destroy)
            self._abandon_next()

    def _hold(self, sample: bytes, now_s: float) -> None:
        self.held.append((sample, now_s))
        if self._awaits_silence:  # the sample before is most likely acknowledged just now, so most swaps hold none
            self._move(now_s)
        self._release(now_s)
        if self.held:
            self._on_held()

    def _release(self, now_s: float) -> None:
        left = self._timing.burst
        while self.held and not self.is_holding:
            half_s = self.held[0][1] / 2.0
            if self._shift_s == -math.inf:
                self._shift_s = now_s - half_s
            if self._shift_s + half_s > now_s:
                return
            sample, _ = self.held.popleft()
            left -= 1
            if left <= 0:
                self._shift_s = now_s - half_s
            try:
                self.current.publish(sample)
            except Exception:
                self.failed += 1
                raise
            now_s = self._clock()
            if self.state is SwapState.PROVING:
                self._trial += 1
                self._since_s = now_s
            if self._awaits_silence and self.held:
                self._move(now_s)
        self._shift_s = -math.inf

    def _move(self, now_s: float) -> None:
        with self.lock:
            before = self.current
            try:
                self._retire(now_s)
                if self._wanted is not None and self._may_begin(self._wanted):
                    self._begin(self._wanted, now_s)
                if self.state is SwapState.MATCHING:
                    self._match(now_s)
                if self.state in {SwapState.WATCHING, SwapState.HOLDING}:
                    self._watch(now_s)
                if self.state is SwapState.PROVING:
                    self._prove(now_s)
                if self.state is SwapState.DOUBTING:
                    self._doubt(now_s)
            finally:
                if self.current is not before:
                    self._missed += before.deadlines_missed() - self.current.deadlines_missed()
        while self._results:  # without the lock: who hears of them may wait for a thread that waits for it
            self._on_result(*self._results.popleft())

    def _may_begin(self, qos: WriterQos) -> bool:
        if self._next is None:
            return len(self._draining) < self._timing.most_draining
        if self._trial and not self._is_proven:
            return False  # no other writer has the samples on trial
        return qos == self._qos or not self._has_all_readers()

    def _begin(self, qos: WriterQos, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            self._give_up(SwapResult.SUPERSEDED, now_s)
        if qos == self._qos:
            return
        self.begun += 1
        self._seconds.clear()
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - the middleware may raise anything, and the old writer stays
            self._finish(SwapResult.FAILED, qos)
            return
        self._next_qos = qos
        self._enter(SwapState.MATCHING, now_s)
        self._created_s = self._readers_since_s = now_s
        self._readers = (0, 0)
        self._watch_s = self._timing.watch_s
        self._trial = 0
        self._can_prove = self._is_late = self._is_proven = self._is_doubted = False

    def _enter(self, state: SwapState, now_s: float) -> None:
        if self.state is not SwapState.IDLE:
            # Two threads read the clock before they take the lock, so a later time may arrive first.
            self._seconds[self.state.value] += max(0.0, now_s - self._entered_s)
        self.state, self._since_s, self._entered_s = state, now_s, max(now_s, self._entered_s)
        self._awaits_silence = state in {SwapState.WATCHING, SwapState.HOLDING, SwapState.PROVING}
        self.current = self._next if self._next is not None and state is SwapState.PROVING else self._current

    def _finish(self, result: SwapResult, qos: WriterQos) -> None:
        self.last = SwapRecord(
            number=self.begun,
            result=result.value,
            depth=qos.depth,
            deadline_ns=qos.deadline_ns,
            seconds_by_phase=dict(self._seconds),
        )
        self._results.append((result, qos))

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._next.disconnects_readers():
            self._give_up(SwapResult.INCOMPATIBLE, now_s)
            return
        # The readers' side matches later than this side, so each change starts the settle time again.
        readers = (self._current.matched(), self._next.matched())
        if readers != self._readers:
            self._readers, self._readers_since_s = readers, now_s
            self._is_proven = False
            self._can_prove = self._next.readers_acknowledge()
        unchanged_s = now_s - self._readers_since_s
        if self._has_all_readers():
            # Readers that keep joining cannot delay the switch without end; the proof covers the last ones.
            if unchanged_s >= self._settle_s or self._is_overdue(now_s):
                self._enter(SwapState.WATCHING, now_s)
        elif unchanged_s > self._timing.match_timeout_s:
            self._give_up(SwapResult.UNMATCHED, now_s)

    def _watch(self, now_s: float) -> None:
        """Wait for an instant at which the old writer is fully acknowledged; hold samples to create one."""
        assert self._next is not None
        if not self._has_all_readers():
            self._enter(SwapState.MATCHING, now_s)
            return
        elapsed_s = now_s - self._since_s
        self._is_late = not _is_served(self._current)
        if self._is_late and now_s < self._created_s + self._settle_s + self._timing.patience_s:
            if self.state is SwapState.WATCHING and elapsed_s >= self._watch_s:
                self._enter(SwapState.HOLDING, now_s)
            elif self.state is SwapState.HOLDING and elapsed_s >= self._timing.hold_s:
                self._watch_s = math.inf
                self._enter(SwapState.WATCHING, now_s)
        elif self._is_proven or self._next.matched() == 0:
            self._take_over(now_s)
        else:
            self._trial = 0
            self._enter(SwapState.PROVING, now_s)

    def _prove(self, now_s: float) -> None:
        """Take over as soon as all samples that left by the new writer are acknowledged."""
        assert self._next is not None
        elapsed_s = now_s - self._since_s
        if not self._has_all_readers():
            self._enter(SwapState.DOUBTING if self._trial else SwapState.MATCHING, now_s)
        elif self._trial and _is_served(self._next):
            self._take_over(now_s)
        elif self.is_holding and elapsed_s >= self._timing.hold_s:
            self._enter(SwapState.DOUBTING, now_s)
        elif not self._trial and (elapsed_s >= self._settle_s or self._is_overdue(now_s)):
            self._take_over(now_s)  # nothing is published, and the readers had twice the time to match
        elif elapsed_s >= self._timing.match_timeout_s:
            self._enter(SwapState.DOUBTING, now_s)

    def _doubt(self, now_s: float) -> None:
        """Wait for the acknowledgement of the new writer's samples, while the old one goes on."""
        assert self._next is not None
        self._is_doubted = True
        if _is_served(self._next):
            self._is_proven = True
            self._enter(SwapState.MATCHING, now_s)
        elif now_s - self._since_s > self._timing.match_timeout_s:
            self._give_up(SwapResult.UNMATCHED, now_s)
            self._results.append((SwapResult.UNDELIVERED, self._next_qos))

    def _take_over(self, now_s: float) -> None:
        assert self._next is not None
        self._draining.append(_Draining(writer=self._current, qos=self._qos, since_s=now_s))
        self._current, self._qos = self._next, self._next_qos
        self._next = None
        self._enter(SwapState.IDLE, now_s)
        may_reorder = self._is_late or self._is_doubted
        self._finish(SwapResult.REORDER_POSSIBLE if may_reorder else SwapResult.OK, self._qos)

    def _retire(self, now_s: float) -> None:
        for old in tuple(self._draining):
            is_served = _is_served(old.writer)
            if is_served or now_s - old.since_s >= self._timing.drain_s:
                self._draining.remove(old)  # first: if something below raises, it must not be destroyed twice
                old.writer.destroy()
                if not is_served:
                    self._results.append((SwapResult.UNDELIVERED, old.qos))

    @property
    def _is_link_clean(self) -> bool:
        return self.loss_ratio is not None and self.loss_ratio < CLEAN_LOSS_RATIO

    @property
    def _settle_s(self) -> float:
        timing = self._timing
        clean_s = timing.clean_settle_s if self._can_prove else timing.clean_unproven_s
        return min(timing.settle_s, clean_s) if self._is_link_clean else timing.settle_s

    def _has_all_readers(self) -> bool:
        assert self._next is not None
        return self._next.matched() >= self._current.matched()

    def _is_overdue(self, now_s: float) -> bool:
        return now_s - self._created_s >= self._timing.match_timeout_s

    def _give_up(self, result: SwapResult, now_s: float) -> None:
        self._enter(SwapState.IDLE, now_s)
        self._abandon_next()
        self._finish(result, self._next_qos)

    def _abandon_next(self) -> None:
        abandoned, self._next, self.state = self._next, None, SwapState.IDLE
        self.current, self._awaits_silence = self._current, False
        if abandoned is not None:
            abandoned.destroy()


def _is_served(writer: Writer) -> bool:
    """Return whether no reader waits for a sample of this writer."""
    return writer.matched() == 0 or writer.is_acknowledged()
