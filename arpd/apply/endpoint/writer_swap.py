"""The make-before-break swap of one publisher's writer, as an explicit state machine.

Design: docs/design.md, The writer swap.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Generic, TypeVar

from arpd.apply.endpoint.swap_ledger import SwapLedger
from arpd.model.endpoints import SwapPhase, SwapResult, Writer, WriterQos

if TYPE_CHECKING:
    from collections.abc import Callable

W = TypeVar("W", bound=Writer)


class SwapState(StrEnum):
    """Where a swap stands; see `WriterSwap` for the transitions."""

    IDLE = "idle"
    MATCHING = "matching"
    WATCHING = "watching"
    HOLDING = "holding"
    PROVING = "proving"
    DOUBTING = "doubting"


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapTiming:
    """Timeouts of the state machine (s).

    Parameters
    ----------
    settle_s : least time between the last change of the matched readers and the switch, for the readers' side to match
    match_timeout_s : a new writer that a reader does not match, or has nothing of, for so long is given up; readers
        that keep joining put the switch off for no longer
    watch_s : how long an instant is looked for at which the old writer is acknowledged anyway, before samples are held;
        once: where that is no use acknowledgements are slow, as with Fast DDS's default heartbeat of 3 s
    hold_s : longest time samples are held at a time
    patience_s : after that the new writer takes over from one that never is fully acknowledged
    drain_s : longest life of an old writer after the switch
    most_draining : old writers that may drain at a time; the next swap waits, so that histories cannot pile up
    """

    settle_s: float = 3.0  # at 10 % loss, of 570 readers half matched at once, 2 % after 1 s, the last after 2.8 s
    match_timeout_s: float = 10.0
    watch_s: float = 0.3
    hold_s: float = 0.3
    patience_s: float = 4.0  # a heartbeat of the default period, 3 s, comes within it
    drain_s: float = 4.0
    most_draining: int = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class _Draining:
    writer: Writer
    qos: WriterQos
    since_s: float


class WriterSwap(Generic[W]):
    """Owns the writers of one publisher and replaces them without losing a sample.

    IDLE → MATCHING: a request that differs from what is in force creates a new writer.
    MATCHING → WATCHING: the new writer has as many readers as the old one and has settled.
    MATCHING → IDLE (unmatched, incompatible): it does not within ``match_timeout_s``, or a reader refuses its QoS; the
    new writer is destroyed.
    WATCHING → PROVING: the old writer is fully acknowledged, or ``patience_s`` are over.
    WATCHING → HOLDING: it was not for ``watch_s``; new samples wait, so that it can be.
    HOLDING → PROVING: it is now.
    HOLDING → WATCHING: it is not within the hold time; what was held leaves by the old writer, and no more is held.
    PROVING → IDLE (ok, reorder_possible): samples leave by the new writer, no more than it surely keeps, and all of
    them were acknowledged.
    PROVING → DOUBTING: they were not, even with further ones held for the hold time: the reader's side of the match may
    be late. What was held leaves by the old writer.
    DOUBTING → MATCHING: they are acknowledged at last; the new writer need not prove itself again.
    DOUBTING → IDLE (unmatched): they are not within ``match_timeout_s``.
    In each state, a reader that joined and is not yet served by the new writer leads back to MATCHING.
    The old writer then drains beside the new one until acknowledged, alone, or ``drain_s`` old.

    The proof is there because matching is known on the writer's own side only: on a lossy link the reader's side
    follows up to seconds later, and a small history would have forgotten by then what was written meanwhile.

    A newer request supersedes one that still waits for readers, or that it takes back; nothing is lost, because samples
    still leave by the old writer. A swap that has its readers is finished first: so requests that never cease cannot
    keep each other from ever coming into force.

    Invariant: until `close`, ``current`` is at every moment a live writer, and every sample is written exactly once.

    Parameters
    ----------
    create : makes a writer with the given QoS; may raise
    on_result : told how every swap ended, and the QoS it was about
    qos : what the first writer runs with

    Attributes
    ----------
    ledger : what the swaps took; of those it calls begun all but the one under way have a result, and each one result
        beside ``undelivered``
    needs_proof : whether a new writer must prove that its readers receive; not when it can serve late ones itself
    """

    def __init__(
        self,
        *,
        create: Callable[[WriterQos], W],
        on_result: Callable[[SwapResult, WriterQos], None],
        qos: WriterQos,
        timing: SwapTiming | None = None,
    ) -> None:
        self._create = create
        self._on_result = on_result
        self._timing = timing or SwapTiming()
        self._qos = qos
        self._current = create(qos)
        self._wanted: WriterQos | None = None
        self._next: W | None = None
        self._next_qos = qos
        self._created_s = 0.0
        self._readers = (0, 0)  # of the current and the next writer, when last looked at
        self._readers_since_s = 0.0
        self._patient_until_s = 0.0
        self._since_s = 0.0  # when the state was entered, or samples of it began to be held
        self._watch_s = 0.0
        self._is_late = False  # switched with the old writer not fully acknowledged
        self._trial = 0  # samples the new writer has, before it has proved that they arrive
        self._is_proven = False
        self._is_doubted = False
        self._draining: list[_Draining] = []
        self._is_closed = False
        self.ledger = SwapLedger()
        self.needs_proof = True
        self.state = SwapState.IDLE

    @property
    def current(self) -> W:
        """The writer samples leave by."""
        if self.state is SwapState.PROVING:
            assert self._next is not None
            return self._next
        return self._current

    @property
    def qos(self) -> WriterQos:
        """QoS of the current writer."""
        return self._next_qos if self.state is SwapState.PROVING else self._qos

    @property
    def is_busy(self) -> bool:
        """Whether `step` has anything to do."""
        return self.state is not SwapState.IDLE or self._wanted is not None or bool(self._draining)

    @property
    def awaits_silence(self) -> bool:
        """Whether the instant before a sample leaves is the one to `step` at."""
        if self.state is SwapState.IDLE:
            return False  # asked for every sample, and mostly so
        return self.state in {SwapState.WATCHING, SwapState.HOLDING, SwapState.PROVING}

    @property
    def is_holding(self) -> bool:
        """Whether new samples should wait in the pacing queue."""
        return self.state is SwapState.HOLDING or (
            self.state is SwapState.PROVING and self._trial >= self.most_on_trial
        )

    @property
    def most_on_trial(self) -> int:
        """Samples the new writer may get before it has proved that they arrive; it gives up none of so many."""
        return max(1, min(self._qos.depth, self._next_qos.depth) // 2)

    @property
    def poll_s(self) -> float:
        """How soon `step` should look again (s)."""
        if self.is_holding:
            return 0.002  # samples wait for it
        # Each look costs a wake-up: one every 50 ms took 35 ms of CPU per swap on an idle topic.
        return min(0.2, self._timing.settle_s / 4.0) if self.state is SwapState.MATCHING else 0.1

    def request(self, qos: WriterQos) -> None:
        """Ask for new QoS; the newest request wins, one that changes nothing is no swap."""
        if self._is_closed:
            return
        target = self._next_qos if self._next is not None else self._qos
        self._wanted = None if qos == target else qos

    def wrote(self, now_s: float) -> None:
        """Take note that a sample was written by `current`."""
        if self.state is SwapState.PROVING:
            self._trial += 1
            self._since_s = now_s

    def step(self, now_s: float) -> None:
        """Move on as far as the writers allow; never blocks."""
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

    def close(self) -> None:
        """Destroy every writer, whatever one of them raises; nothing happens after that."""
        if self._is_closed:
            return
        self._is_closed, self._wanted = True, None
        draining, self._draining = self._draining, []
        with ExitStack() as stack:
            stack.callback(self._current.destroy)
            for old in draining:
                stack.callback(old.writer.destroy)
            self._abandon_next()

    def _may_begin(self, qos: WriterQos) -> bool:
        if self._next is None:
            return len(self._draining) < self._timing.most_draining
        if self._trial and not self._is_proven:
            return False  # the new writer has samples that nobody else has
        return qos == self._qos or not self._has_all_readers()

    def _begin(self, qos: WriterQos, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            self._give_up(SwapResult.SUPERSEDED, now_s)
        if qos == self._qos:
            return
        self.ledger.begin()
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - whatever the middleware raises, the old writer stays
            self._finish(SwapResult.FAILED, qos, now_s)
            return
        self._next_qos = qos
        self._enter(SwapState.MATCHING, now_s)
        self._created_s = self._readers_since_s = now_s
        self._patient_until_s = now_s + self._timing.settle_s + self._timing.patience_s
        self._readers = (0, 0)
        self._watch_s = self._timing.watch_s
        self._trial = 0
        self._is_late = self._is_proven = self._is_doubted = False

    def _enter(self, state: SwapState, now_s: float) -> None:
        self.state, self._since_s = state, now_s
        self.ledger.enter(SwapPhase(state.value), now_s)

    def _finish(self, result: SwapResult, qos: WriterQos, now_s: float) -> None:
        self.ledger.finish(result, qos, now_s)
        self._on_result(result, qos)

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._next.disconnects_readers():
            self._give_up(SwapResult.INCOMPATIBLE, now_s)
            return
        # The readers' side of a match follows this side's, so a reader that comes later is waited for as long.
        readers = (self._current.matched(), self._next.matched())
        if readers != self._readers:
            self._readers, self._readers_since_s = readers, now_s
            self._is_proven = False
        unchanged_s = now_s - self._readers_since_s
        if self._has_all_readers():
            # Readers that keep joining cannot put the switch off for ever; the proof covers whoever came last.
            if unchanged_s >= self._timing.settle_s or self._is_overdue(now_s):
                self._enter(SwapState.WATCHING, now_s)
        elif unchanged_s > self._timing.match_timeout_s:
            self._give_up(SwapResult.UNMATCHED, now_s)

    def _watch(self, now_s: float) -> None:
        """Take the first instant at which nothing of the old writer's is under way; hold samples to make one."""
        assert self._next is not None
        if not self._has_all_readers():
            self._enter(SwapState.MATCHING, now_s)
            return
        elapsed_s = now_s - self._since_s
        self._is_late = not _is_served(self._current)
        if self._is_late and now_s < self._patient_until_s:
            if self.state is SwapState.WATCHING and elapsed_s >= self._watch_s:
                self._enter(SwapState.HOLDING, now_s)
            elif self.state is SwapState.HOLDING and elapsed_s >= self._timing.hold_s:
                self._watch_s = math.inf
                self._enter(SwapState.WATCHING, now_s)
        elif self._is_proven or not self.needs_proof or self._next.matched() == 0:
            self._take_over(now_s)
        else:
            self._trial = 0
            self._enter(SwapState.PROVING, now_s)

    def _prove(self, now_s: float) -> None:
        """Take the first instant at which all that left by the new writer is known to have arrived."""
        assert self._next is not None
        elapsed_s = now_s - self._since_s
        if not self._has_all_readers():
            self._enter(SwapState.DOUBTING if self._trial else SwapState.MATCHING, now_s)
        elif self._trial and _is_served(self._next):
            self._take_over(now_s)
        elif self.is_holding and elapsed_s >= self._timing.hold_s:
            self._enter(SwapState.DOUBTING, now_s)
        elif not self._trial and (elapsed_s >= self._timing.settle_s or self._is_overdue(now_s)):
            self._take_over(now_s)  # a silent topic: its readers had twice the time
        elif elapsed_s >= self._timing.match_timeout_s:
            self._enter(SwapState.DOUBTING, now_s)

    def _doubt(self, now_s: float) -> None:
        """Go on by the old writer until the new one's samples are acknowledged, however late."""
        assert self._next is not None
        self._is_doubted = True
        if _is_served(self._next):
            self._is_proven = True
            self._enter(SwapState.MATCHING, now_s)
        elif now_s - self._since_s > self._timing.match_timeout_s:
            refused = self._next_qos
            self._give_up(SwapResult.UNMATCHED, now_s)
            self._on_result(SwapResult.UNDELIVERED, refused)

    def _take_over(self, now_s: float) -> None:
        assert self._next is not None
        self._draining.append(_Draining(writer=self._current, qos=self._qos, since_s=now_s))
        self._current, self._qos = self._next, self._next_qos
        self._next, self.state = None, SwapState.IDLE
        is_ordered = not (self._is_late or self._is_doubted)
        self._finish(SwapResult.OK if is_ordered else SwapResult.REORDER_POSSIBLE, self._qos, now_s)

    def _retire(self, now_s: float) -> None:
        for old in tuple(self._draining):
            is_served = _is_served(old.writer)
            drained_s = now_s - old.since_s
            if is_served or drained_s >= self._timing.drain_s:
                self._draining.remove(old)  # first: nothing that raises below may make it go twice
                self.ledger.drain(SwapPhase.DRAINING, drained_s)
                old.writer.destroy()
                if not is_served:
                    self._on_result(SwapResult.UNDELIVERED, old.qos)

    def _has_all_readers(self) -> bool:
        assert self._next is not None
        return self._next.matched() >= self._current.matched()

    def _is_overdue(self, now_s: float) -> bool:
        return now_s - self._created_s >= self._timing.match_timeout_s

    def _give_up(self, result: SwapResult, now_s: float) -> None:
        refused = self._next_qos
        self._abandon_next()
        self._finish(result, refused, now_s)

    def _abandon_next(self) -> None:
        abandoned, self._next, self.state = self._next, None, SwapState.IDLE
        if abandoned is not None:
            abandoned.destroy()


def _is_served(writer: Writer) -> bool:
    """Whether nobody waits for anything this writer still holds."""
    return writer.matched() == 0 or writer.is_acknowledged()
