"""The make-before-break swap of one publisher's writer, as an explicit state machine (shared/SWAP.md)."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, kw_only=True, slots=True)
class WriterQos:
    """The two policies a swap changes: KEEP_LAST depth (samples) and offered deadline (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


class Writer(Protocol):
    """A DDS writer as the swap sees it."""

    def publish(self, sample: bytes) -> None:
        """Write one serialized sample."""

    def matched(self) -> int:
        """Count the matched readers."""

    def is_acknowledged(self) -> bool:
        """Whether every sample written was acknowledged; never blocks."""

    def disconnects_readers(self) -> bool:
        """Whether a reader that its predecessor serves was discovered and refuses this writer's QoS; never blocks."""

    def destroy(self) -> None:
        """Destroy the writer."""


W = TypeVar("W", bound=Writer)


class SwapState(StrEnum):
    """Where a swap stands; see `WriterSwap` for the transitions."""

    IDLE = "idle"
    MATCHING = "matching"
    HOLDING = "holding"


class SwapResult(StrEnum):
    """How a swap ended."""

    OK = "ok"
    REORDER_POSSIBLE = "reorder_possible"  # switched with the old writer not fully acknowledged
    UNMATCHED = "unmatched"  # readers did not match the new writer in time; the old one stays
    INCOMPATIBLE = "incompatible"  # a reader would have been lost to the new QoS; the old writer stays
    SUPERSEDED = "superseded"  # a newer request came first
    UNDELIVERED = "undelivered"  # beside the swap's own result: an old writer was given up with samples unacknowledged
    FAILED = "failed"  # the middleware refused the new writer; the old one stays


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapTiming:
    """Timeouts of the state machine (s).

    Parameters
    ----------
    settle_s : least time between the last change of the matched readers and the switch, for the readers' side to match
    match_timeout_s : after that the new writer is given up
    hold_max_s : longest time samples are held for the old writer's acknowledgement
    drain_s : longest life of an old writer after the switch
    most_draining : old writers that may drain at a time; the next swap waits, so that histories cannot pile up
    """

    settle_s: float = 0.1
    match_timeout_s: float = 5.0
    hold_max_s: float = 0.3
    drain_s: float = 4.0
    most_draining: int = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class _Draining:
    writer: Writer
    qos: WriterQos
    until_s: float


class WriterSwap(Generic[W]):
    """Owns the writers of one publisher and replaces them without losing a sample.

    IDLE → MATCHING: a request that differs from what is in force creates a new writer.
    MATCHING → HOLDING: the new writer has as many readers as the old one and has settled.
    MATCHING → IDLE (unmatched, incompatible): it does not within ``match_timeout_s``, or a reader refuses its QoS; the
    new writer is destroyed.
    HOLDING → MATCHING: a reader joined that the new writer does not serve yet; what was held leaves by the old one.
    HOLDING → IDLE (ok): the old writer is fully acknowledged; its successor takes over.
    HOLDING → IDLE (reorder_possible): it is not within the hold time; the successor takes over all the same.
    The old writer then drains beside the new one until acknowledged, alone, or ``drain_s`` old.

    A newer request supersedes one that still waits for readers, or that it takes back; nothing is lost, because samples
    still leave by the old writer. A swap that has its readers is finished first, which takes no longer than settling
    and holding: so requests that never cease cannot keep each other from ever coming into force.

    Invariant: until `close`, ``current`` is at every moment a live writer, and every sample is written exactly once.

    Parameters
    ----------
    create : makes a writer with the given QoS; may raise
    on_result : told how every swap ended, and the QoS it was about
    qos : what the first writer runs with
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
        self._holding_since_s = 0.0
        self._hold_s = 0.0
        self._draining: list[_Draining] = []
        self._is_closed = False
        self.state = SwapState.IDLE

    @property
    def current(self) -> W:
        """The writer samples leave by."""
        return self._current

    @property
    def qos(self) -> WriterQos:
        """QoS of the current writer."""
        return self._qos

    @property
    def is_busy(self) -> bool:
        """Whether `step` has anything to do."""
        return self.state is not SwapState.IDLE or self._wanted is not None or bool(self._draining)

    @property
    def is_holding(self) -> bool:
        """Whether new samples should wait in the pacing queue."""
        return self.state is SwapState.HOLDING

    @property
    def most_held(self) -> int:
        """Samples that may be held: whichever writer gets them at once must not push its own oldest out (samples)."""
        return min(self._qos.depth, self._next_qos.depth)

    def request(self, qos: WriterQos, *, hold_s: float) -> None:
        """Ask for new QoS; the newest request wins, one that changes nothing is no swap.

        Parameters
        ----------
        hold_s : how long this topic's samples may be held, capped by ``hold_max_s`` (s)
        """
        if self._is_closed:
            return
        self._hold_s = min(hold_s, self._timing.hold_max_s)
        target = self._next_qos if self._next is not None else self._qos
        self._wanted = None if qos == target else qos

    def step(self, now_s: float, *, is_full: bool = False) -> None:
        """Move on as far as the writers allow; never blocks.

        Parameters
        ----------
        is_full : whether no more samples can be held, so that holding must end
        """
        self._retire(now_s)
        if self._wanted is not None and self._may_begin(self._wanted):
            self._begin(self._wanted, now_s)
        if self.state is SwapState.MATCHING:
            self._match(now_s)
        if self.state is SwapState.HOLDING:
            self._switch(now_s, is_full=is_full)

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
        return qos == self._qos or not self._has_all_readers()

    def _begin(self, qos: WriterQos, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            superseded = self._next_qos
            self._abandon_next()
            self._on_result(SwapResult.SUPERSEDED, superseded)
        if qos == self._qos:
            return
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - whatever the middleware raises, the old writer stays
            self._on_result(SwapResult.FAILED, qos)
            return
        self._next_qos, self.state = qos, SwapState.MATCHING
        self._created_s = self._readers_since_s = now_s
        self._readers = (0, 0)

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._next.disconnects_readers():
            self._give_up(SwapResult.INCOMPATIBLE)
            return
        # The readers' side of a match follows this side's, so a reader that comes later is waited for as long.
        readers = (self._current.matched(), self._next.matched())
        if readers != self._readers:
            self._readers, self._readers_since_s = readers, now_s
        if self._has_all_readers() and now_s - self._readers_since_s >= self._timing.settle_s:
            self._holding_since_s, self.state = now_s, SwapState.HOLDING
        elif now_s - self._created_s > self._timing.match_timeout_s:
            self._give_up(SwapResult.UNMATCHED)

    def _switch(self, now_s: float, *, is_full: bool) -> None:
        assert self._next is not None
        if not self._has_all_readers():
            self.state = SwapState.MATCHING
            return
        acknowledged = _is_served(self._current)
        if not (acknowledged or is_full) and now_s - self._holding_since_s < self._hold_s:
            return
        self._draining.append(_Draining(writer=self._current, qos=self._qos, until_s=now_s + self._timing.drain_s))
        self._current, self._qos = self._next, self._next_qos
        self._next, self.state = None, SwapState.IDLE
        self._on_result(SwapResult.OK if acknowledged else SwapResult.REORDER_POSSIBLE, self._qos)

    def _retire(self, now_s: float) -> None:
        for old in tuple(self._draining):
            is_served = _is_served(old.writer)
            if is_served or now_s >= old.until_s:
                self._draining.remove(old)  # first: nothing that raises below may make it go twice
                old.writer.destroy()
                if not is_served:
                    self._on_result(SwapResult.UNDELIVERED, old.qos)

    def _has_all_readers(self) -> bool:
        assert self._next is not None
        return self._next.matched() >= self._current.matched()

    def _give_up(self, result: SwapResult) -> None:
        refused = self._next_qos
        self._abandon_next()
        self._on_result(result, refused)

    def _abandon_next(self) -> None:
        abandoned, self._next, self.state = self._next, None, SwapState.IDLE
        if abandoned is not None:
            abandoned.destroy()


def _is_served(writer: Writer) -> bool:
    """Whether nobody waits for anything this writer still holds."""
    return writer.matched() == 0 or writer.is_acknowledged()
