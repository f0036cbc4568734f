"""The make-before-break replacement of one subscription's reader, as an explicit state machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from arpd.model.endpoints import ReaderSwapResult

if TYPE_CHECKING:
    from collections.abc import Callable

# What tells samples apart: source timestamp (ns) and publication sequence number. rclpy does not say which writer a
# sample is from; two writers would have to write their n-th samples in the same nanosecond to be mistaken.
Key = tuple[int, int]
_MOST_KEYS = 20_000  # 10 s at 2 kHz
_MOST_HELD = 1_000
S = TypeVar("S")
S_co = TypeVar("S_co", covariant=True)
Q = TypeVar("Q")


class Reader(Protocol[S_co]):
    """A DDS reader as the handover sees it."""

    def matched(self) -> int:
        """Count the matched writers."""

    def take(self) -> tuple[Key, S_co] | None:
        """Return the next sample that arrived and that nobody took; never blocks."""

    def destroy(self) -> None:
        """Destroy the reader."""


class ReaderSwapState(StrEnum):
    """Where a handover stands; see `ReaderSwap` for the transitions."""

    IDLE = "idle"
    MATCHING = "matching"
    CATCHING_UP = "catching_up"


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderSwapTiming:
    """Timeouts of the state machine (s).

    Parameters
    ----------
    settle_s : least time both readers are there, for the writers' side to match
    match_timeout_s : after that the new reader is given up
    catch_up_s : longest time the old reader is waited for once the new one is matched
    remember_s : how long after a handover late doubles are still recognised
    """

    settle_s: float = 0.1
    match_timeout_s: float = 5.0
    catch_up_s: float = 2.0
    remember_s: float = 10.0


class ReaderSwap(Generic[Q, S]):
    """Owns the readers of one subscription and replaces them without losing or doubling a sample.

    IDLE → MATCHING: a request that differs from what is in force creates a new reader.
    MATCHING → CATCHING_UP: the new reader has as many writers as the old one and has settled.
    MATCHING → IDLE (unmatched): it does not within ``match_timeout_s``; the new reader is destroyed.
    CATCHING_UP → IDLE (ok): the old reader has delivered all that the new one had when it was matched. A reliable
    reader delivers a writer's samples in order, so it misses nothing that was written before.
    CATCHING_UP → IDLE (incomplete): it has not within ``catch_up_s``; the new reader takes over all the same.

    Until the switch the old reader delivers, and what the new one receives is held. At the switch the old reader is
    emptied first, then what is still held follows: so a writer's samples keep their order.

    Invariant: every sample that reached the reader in force is delivered, and no sample is delivered twice.

    Parameters
    ----------
    create : makes a reader with the given QoS; may raise
    on_result : told how every handover ended
    qos : what the first reader runs with

    Notes
    -----
    Not thread-safe; what `accept` and `step` return is delivered by the owner, in that order.
    """

    def __init__(
        self,
        *,
        create: Callable[[Q], Reader[S]],
        on_result: Callable[[ReaderSwapResult], None],
        qos: Q,
        timing: ReaderSwapTiming | None = None,
    ) -> None:
        self._create = create
        self._on_result = on_result
        self._timing = timing or ReaderSwapTiming()
        self._qos = self._next_qos = qos
        self._wanted: Q | None = None
        self._next: Reader[S] | None = None
        self._retired: Reader[S] | None = None
        self._held: dict[Key, S] = {}
        self._awaited: frozenset[Key] = frozenset()
        self._delivered: dict[Key, None] = {}
        self._since_s = 0.0
        self._remember_until_s = 0.0
        self.is_tracking = False
        self.state = ReaderSwapState.IDLE
        self._current = create(qos)

    @property
    def current(self) -> Reader[S]:
        """The reader in force."""
        return self._current

    @property
    def qos(self) -> Q:
        """QoS of the reader in force."""
        return self._qos

    @property
    def is_busy(self) -> bool:
        """Whether `step` has anything to do."""
        return self.state is not ReaderSwapState.IDLE or self._wanted is not None

    def request(self, qos: Q) -> None:
        """Ask for new QoS; the newest request wins, one that changes nothing is no handover."""
        target = self._next_qos if self._next is not None else self._qos
        self._wanted = None if qos == target else qos

    def accept(self, reader: Reader[S], key: Key, sample: S, *, now_s: float) -> list[S]:
        """Take a sample from one of the readers; return what is to be delivered now.

        Only needed while ``is_tracking``; without a handover under way every sample is delivered as it comes.
        """
        if self.is_tracking and self.state is ReaderSwapState.IDLE and now_s >= self._remember_until_s:
            self._forget()
        if not self.is_tracking:
            return [sample]
        if reader is self._next:
            self._hold(key, sample)
            return []
        if reader is not self._current and reader is not self._retired:
            return []  # of a reader that was given up; the one in force has it too
        return self._fresh(key, sample)

    def step(self, now_s: float) -> list[S]:
        """Move on as far as the readers allow; never blocks. Return what is to be delivered now."""
        if self._wanted is not None:
            self._begin(self._wanted, now_s)
        if len(self._held) > _MOST_HELD:
            self._abandon(ReaderSwapResult.FAILED, now_s)
        if self.state is ReaderSwapState.MATCHING:
            self._match(now_s)
        if self.state is ReaderSwapState.CATCHING_UP:
            return self._catch_up(now_s)
        return []

    def close(self) -> None:
        """Destroy every reader."""
        if self._next is not None:
            self._next.destroy()
            self._next = None
        self.state, self._wanted = ReaderSwapState.IDLE, None
        self._forget()
        self._current.destroy()

    def _begin(self, qos: Q, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            self._abandon(ReaderSwapResult.SUPERSEDED, now_s)
        if qos == self._qos:
            return
        self.is_tracking = True  # before the new reader exists: what it will have too must be known from now on
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - whatever the middleware raises, the old reader stays
            self._remember_until_s = now_s
            self._on_result(ReaderSwapResult.FAILED)
            return
        self._next_qos, self._since_s, self.state = qos, now_s, ReaderSwapState.MATCHING

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._is_matched() and now_s - self._since_s >= self._timing.settle_s:
            while (taken := self._next.take()) is not None:
                self._hold(*taken)
            self._awaited = frozenset(self._held)
            self._since_s, self.state = now_s, ReaderSwapState.CATCHING_UP
        elif now_s - self._since_s > self._timing.match_timeout_s:
            self._abandon(ReaderSwapResult.UNMATCHED, now_s)

    def _catch_up(self, now_s: float) -> list[S]:
        if not self._is_matched():  # a writer came that only the old reader knows as yet
            self._since_s, self.state = now_s, ReaderSwapState.MATCHING
            return []
        is_complete = self._held.keys().isdisjoint(self._awaited)
        if not is_complete and now_s - self._since_s < self._timing.catch_up_s:
            return []
        return self._switch(now_s, ReaderSwapResult.OK if is_complete else ReaderSwapResult.INCOMPLETE)

    def _switch(self, now_s: float, result: ReaderSwapResult) -> list[S]:
        assert self._next is not None
        out: list[S] = []
        while (taken := self._current.take()) is not None:
            out += self._fresh(*taken)
        # What reaches the old reader from here on reaches the new one too.
        self._current.destroy()
        for key, sample in tuple(self._held.items()):
            out += self._fresh(key, sample)
        self._retired, self._current, self._qos = self._current, self._next, self._next_qos
        self._end(now_s)
        self._on_result(result)
        return out

    def _abandon(self, result: ReaderSwapResult, now_s: float) -> None:
        assert self._next is not None
        self._next.destroy()
        self._end(now_s)
        self._on_result(result)

    def _end(self, now_s: float) -> None:
        self._held.clear()
        self._awaited = frozenset()
        self._next, self.state = None, ReaderSwapState.IDLE
        self._remember_until_s = now_s + self._timing.remember_s

    def _is_matched(self) -> bool:
        return self._next is not None and self._next.matched() >= self._current.matched()

    def _hold(self, key: Key, sample: S) -> None:
        if key not in self._delivered:
            self._held[key] = sample

    def _fresh(self, key: Key, sample: S) -> list[S]:
        if key in self._delivered:
            return []
        self._held.pop(key, None)
        self._delivered[key] = None
        if len(self._delivered) > _MOST_KEYS:
            del self._delivered[next(iter(self._delivered))]
        return [sample]

    def _forget(self) -> None:
        self.is_tracking = False
        self._retired = None
        self._delivered.clear()
        self._held.clear()
