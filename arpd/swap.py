"""The make-before-break swap of one publisher's writer, as an explicit state machine (shared/SWAP.md)."""

from __future__ import annotations

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
    SUPERSEDED = "superseded"  # a newer request came first
    UNDELIVERED = "undelivered"  # beside the swap's own result: an old writer was given up with samples unacknowledged
    FAILED = "failed"  # the middleware refused the new writer; the old one stays


@dataclass(frozen=True, kw_only=True, slots=True)
class SwapTiming:
    """Timeouts of the state machine (s).

    Parameters
    ----------
    settle_s : least time between creation and switch, for the readers' side to match
    match_timeout_s : after that the new writer is given up
    hold_max_s : longest time samples are held for the old writer's acknowledgement
    drain_s : longest life of an old writer after the switch
    """

    settle_s: float = 0.1
    match_timeout_s: float = 5.0
    hold_max_s: float = 0.3
    drain_s: float = 4.0


@dataclass(slots=True)
class _Draining:
    writer: Writer
    until_s: float


class WriterSwap(Generic[W]):
    """Owns the writers of one publisher and replaces them without losing a sample.

    IDLE → MATCHING: a request that differs from what is in force creates a new writer.
    MATCHING → HOLDING: the new writer has as many readers as the old one and has settled.
    MATCHING → IDLE (unmatched): it does not within ``match_timeout_s``; the new writer is destroyed.
    HOLDING → IDLE (ok): the old writer is fully acknowledged; its successor takes over.
    HOLDING → IDLE (reorder_possible): it is not within the hold time; the successor takes over all the same.
    The old writer then drains beside the new one until acknowledged, alone, or ``drain_s`` old. A newer request in
    MATCHING or HOLDING supersedes the older one; nothing is lost because samples still leave by the old writer.

    Invariant: ``current`` is at every moment a live writer, and every sample is written exactly once.

    Parameters
    ----------
    create : makes a writer with the given QoS; may raise
    on_result : told how every swap ended
    qos : what the first writer runs with
    """

    def __init__(
        self,
        *,
        create: Callable[[WriterQos], W],
        on_result: Callable[[SwapResult], None],
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
        self._since_s = 0.0
        self._hold_s = 0.0
        self._draining: list[_Draining] = []
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

    def request(self, qos: WriterQos, *, hold_s: float) -> None:
        """Ask for new QoS; the newest request wins, one that changes nothing is no swap.

        Parameters
        ----------
        hold_s : how long this topic's samples may be held, capped by ``hold_max_s`` (s)
        """
        self._hold_s = min(hold_s, self._timing.hold_max_s)
        target = self._next_qos if self._next is not None else self._qos
        self._wanted = None if qos == target else qos

    def step(self, now_s: float) -> None:
        """Move on as far as the writers allow; never blocks."""
        self._retire(now_s)
        if self._wanted is not None:
            self._begin(self._wanted, now_s)
        if self.state is SwapState.MATCHING:
            self._match(now_s)
        if self.state is SwapState.HOLDING:
            self._switch(now_s)

    def close(self) -> None:
        """Destroy every writer."""
        self._abandon_next()
        for old in self._draining:
            old.writer.destroy()
        self._draining.clear()
        self._current.destroy()

    def _begin(self, qos: WriterQos, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            self._abandon_next()
            self._on_result(SwapResult.SUPERSEDED)
        if qos == self._qos:
            return
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - whatever the middleware raises, the old writer stays
            self._on_result(SwapResult.FAILED)
            return
        self._next_qos, self._since_s, self.state = qos, now_s, SwapState.MATCHING

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._next.matched() >= self._current.matched() and now_s - self._since_s >= self._timing.settle_s:
            self._since_s, self.state = now_s, SwapState.HOLDING
        elif now_s - self._since_s > self._timing.match_timeout_s:
            self._abandon_next()
            self._on_result(SwapResult.UNMATCHED)

    def _switch(self, now_s: float) -> None:
        assert self._next is not None
        acknowledged = self._current.matched() == 0 or self._current.is_acknowledged()
        if not acknowledged and now_s - self._since_s < self._hold_s:
            return
        self._draining.append(_Draining(self._current, now_s + self._timing.drain_s))
        self._current, self._qos = self._next, self._next_qos
        self._next, self.state = None, SwapState.IDLE
        self._on_result(SwapResult.OK if acknowledged else SwapResult.REORDER_POSSIBLE)

    def _retire(self, now_s: float) -> None:
        staying = []
        for old in self._draining:
            acknowledged = old.writer.matched() == 0 or old.writer.is_acknowledged()
            if acknowledged or now_s >= old.until_s:
                if not acknowledged:
                    self._on_result(SwapResult.UNDELIVERED)
                old.writer.destroy()
            else:
                staying.append(old)
        self._draining = staying

    def _abandon_next(self) -> None:
        if self._next is not None:
            self._next.destroy()
        self._next, self.state = None, SwapState.IDLE
