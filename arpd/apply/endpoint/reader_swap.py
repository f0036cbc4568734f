"""The reader swap of one subscription, as a state machine (docs/design.md, The reader swap)."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from arpd.model.endpoints import ReaderSwapResult

if TYPE_CHECKING:
    from collections.abc import Callable

# Identity of a sample: source timestamp (ns) and publication sequence number. rclpy does not name the writer, so two
# samples are confused only when two writers write their n-th samples in the same nanosecond.
Key = tuple[int, int]
_MOST_KEYS = 20_000  # 10 s at 2 kHz
_MOST_HELD = 1_000
_SETTLE_S = 0.3  # least time that both readers live, so that the writers' side matches too
_MOST_SETTLE_S = 2.0  # a shallow new reader may drop samples for as long as both live
_MATCH_TIMEOUT_S = 5.0
_REMEMBER_S = 10.0  # time after a swap in which late duplicates are recognised
S = TypeVar("S")
S_co = TypeVar("S_co", covariant=True)
Q = TypeVar("Q")


class Reader(Protocol[S_co]):
    """A DDS reader as the swap sees it."""

    def matched(self) -> int:
        """Count the matched writers."""

    def take(self) -> tuple[Key, S_co] | None:
        """Take the next sample that arrived; never blocks."""

    def destroy(self) -> None:
        """Destroy the reader."""


class ReaderSwapState(StrEnum):
    """State of a swap; see `ReaderSwap` for the transitions."""

    IDLE = "idle"
    MATCHING = "matching"
    CATCHING_UP = "catching_up"


class ReaderSwap(Generic[Q, S]):
    """Owns the readers of one subscription and replaces them without losing or doubling a sample.

    IDLE → MATCHING: a request differs from the QoS in force; a new reader is created.
    MATCHING → CATCHING_UP: the new reader has as many writers as the old one, and for 0.3 s the old one has had no
    sample that the new one lacks. Such a sample shows a writer that does not know the new reader yet, because the link
    between them is busy. After 2 s the swap goes on anyway.
    MATCHING → IDLE (unmatched): it does not have them within 5 s. The new reader is destroyed.
    CATCHING_UP → IDLE (ok): the old reader has delivered all that the new one had when it was matched. A reliable
    reader delivers a writer's samples in order, so it has delivered all earlier ones too.
    CATCHING_UP → IDLE (incomplete): it has not within ``catch_up_s``. The new reader takes over all the same.
    CATCHING_UP → MATCHING: a writer joins that the new reader has not matched yet.

    Until the switch the old reader delivers, and the samples of the new one are held. At the switch the old reader is
    emptied first, and the samples still held follow, so each writer's samples keep their order.

    Invariant: every sample that reached the reader in force is delivered, and no sample is delivered twice.

    Parameters
    ----------
    create : makes a reader with the given QoS; may raise
    on_result : called with the result of every swap
    qos : QoS of the first reader
    catch_up_s : longest time to wait for the old reader once the new one is matched (s)

    Attributes
    ----------
    current, qos : the reader in force, and its QoS
    is_tracking : whether samples must pass `accept`; without a swap they are delivered as they come

    Notes
    -----
    Not thread-safe. The owner delivers what `accept` and `step` return, in that order.
    """

    def __init__(
        self,
        *,
        create: Callable[[Q], Reader[S]],
        on_result: Callable[[ReaderSwapResult], None],
        qos: Q,
        catch_up_s: float = 2.0,
    ) -> None:
        self._create = create
        self._on_result = on_result
        self._catch_up_s = catch_up_s
        self._next_qos = qos
        self._wanted: Q | None = None
        self._next: Reader[S] | None = None
        self._retired: Reader[S] | None = None
        self._held: dict[Key, S] = {}
        self._lacking: dict[Key, float] = {}
        self._awaited: frozenset[Key] = frozenset()
        self._delivered: dict[Key, None] = {}
        self._since_s = 0.0
        self._remember_until_s = 0.0
        self.is_tracking = False
        self.state = ReaderSwapState.IDLE
        self.qos = qos
        self.current = create(qos)

    @property
    def is_busy(self) -> bool:
        """True while `step` has anything to do."""
        return self.state is not ReaderSwapState.IDLE or self._wanted is not None

    @property
    def will_create(self) -> bool:
        """True if the next `step` makes a reader, which takes some milliseconds."""
        return self._wanted is not None and self._wanted != self.qos

    def request(self, qos: Q) -> None:
        """Request new QoS; the newest request wins, and one that changes nothing is no swap."""
        target = self._next_qos if self._next is not None else self.qos
        self._wanted = None if qos == target else qos

    def accept(self, reader: Reader[S], key: Key, sample: S, *, now_s: float) -> list[S]:
        """Take a sample of one of the readers; return the samples to deliver now."""
        if self.is_tracking and self.state is ReaderSwapState.IDLE and now_s >= self._remember_until_s:
            self._forget()
        if not self.is_tracking:
            return [sample]
        if reader is self._next:
            self._hold(key, sample)
            return []
        if reader is not self.current and reader is not self._retired:
            return []  # from an abandoned reader; the one in force has it too
        if self._next is not None and reader is self.current and key not in self._held:
            self._lacking[key] = now_s
        return self._fresh(key, sample)

    def step(self, now_s: float) -> list[S]:
        """Move on as far as the readers allow, without blocking; return the samples to deliver now."""
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
        self.current.destroy()

    def _begin(self, qos: Q, now_s: float) -> None:
        self._wanted = None
        if self._next is not None:
            self._abandon(ReaderSwapResult.SUPERSEDED, now_s)
        if qos == self.qos:
            return
        self.is_tracking = True  # before the new reader exists: it may receive every sample from now on too
        try:
            self._next = self._create(qos)
        except Exception:  # noqa: BLE001 - the middleware may raise anything, and the old reader stays
            self._remember_until_s = now_s
            self._on_result(ReaderSwapResult.FAILED)
            return
        self._next_qos, self._since_s, self.state = qos, now_s, ReaderSwapState.MATCHING

    def _match(self, now_s: float) -> None:
        assert self._next is not None
        if self._is_matched() and self._is_settled(now_s):
            while (taken := self._next.take()) is not None:
                self._hold(*taken)
            self._awaited = frozenset(self._held)
            self._since_s, self.state = now_s, ReaderSwapState.CATCHING_UP
        elif now_s - self._since_s > _MATCH_TIMEOUT_S:
            self._abandon(ReaderSwapResult.UNMATCHED, now_s)

    def _catch_up(self, now_s: float) -> list[S]:
        if not self._is_matched():  # a writer joined that only the old reader has matched
            self._since_s, self.state = now_s, ReaderSwapState.MATCHING
            return []
        is_complete = self._held.keys().isdisjoint(self._awaited)
        if not is_complete and now_s - self._since_s < self._catch_up_s:
            return []
        return self._switch(now_s, ReaderSwapResult.OK if is_complete else ReaderSwapResult.INCOMPLETE)

    def _switch(self, now_s: float, result: ReaderSwapResult) -> list[S]:
        assert self._next is not None
        out: list[S] = []
        while (taken := self.current.take()) is not None:
            out += self._fresh(*taken)
        # Samples that reach the old reader from here on reach the new one too.
        self.current.destroy()
        for key, sample in tuple(self._held.items()):
            out += self._fresh(key, sample)
        self._retired, self.current, self.qos = self.current, self._next, self._next_qos
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
        self._lacking.clear()
        self._awaited = frozenset()
        self._next, self.state = None, ReaderSwapState.IDLE
        self._remember_until_s = now_s + _REMEMBER_S

    def _is_matched(self) -> bool:
        return self._next is not None and self._next.matched() >= self.current.matched()

    def _is_settled(self, now_s: float) -> bool:
        latest_s = max((self._since_s, *self._lacking.values()))
        return now_s - latest_s >= _SETTLE_S or now_s - self._since_s >= _MOST_SETTLE_S

    def _hold(self, key: Key, sample: S) -> None:
        self._lacking.pop(key, None)
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
