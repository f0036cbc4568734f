"""Due times of the publishers of one node, and the order in which the pacing thread serves them."""

from __future__ import annotations

import math
from heapq import heapify, heappop, heappush
from itertools import count
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_PATIENCE_S = 1.0
_MOST_OUTDATED = 100
_TAKEN = (-math.inf, -1)

T = TypeVar("T")


class Wakeups(Generic[T]):
    """Due times of the publishers, and a queue of those that are due at once.

    Only `wake` and `end` may be called from other threads. A publisher that is woken is due until it is taken; one that
    is woken while it is served is due again.

    A write blocks while the link's queue is full, so of those that are due the smallest comes first: an IMU then waits
    for one sample of a camera at most. Once a second the one that waits longest comes first, if it waits for more than
    a second, so that a thread with too much to do serves everybody.

    Parameters
    ----------
    size : returns the size of one's samples
    """

    def __init__(self, size: Callable[[T], float]) -> None:
        self._size = size
        self._due_s: dict[T, float] = {}
        self._by_time: list[tuple[float, int, T]] = []  # heap; an entry counts while `_due_s` has the same time
        self._ready: dict[T, tuple[float, int]] = {}  # those found due, the time they were found, number; oldest first
        self._by_size: list[tuple[float, int, T]] = []  # heap; an entry counts while `_ready` has the same number
        self._numbers = count()
        self._relieved_s = -math.inf  # when the one that waited longest last came first
        self._woken: SimpleQueue[T | None] = SimpleQueue()

    def wake(self, one: T) -> None:
        """Make one due at once."""
        self._woken.put(one)

    def end(self) -> None:
        """Let `wait` return without waking any."""
        self._woken.put(None)

    def wait(self, for_s: float) -> None:
        """Wait until one is woken, or the time is over."""
        try:
            woken = self._woken.get(timeout=max(0.0, for_s))
        except Empty:
            return
        if woken is not None:
            self.set(woken, -math.inf)

    def look(self, now_s: float) -> None:
        """Find those that are due."""
        try:
            while True:
                if (woken := self._woken.get_nowait()) is not None:
                    self.set(woken, -math.inf)
        except Empty:
            pass
        while self._earliest_s() <= now_s and self._by_time:
            one = heappop(self._by_time)[2]
            del self._due_s[one]
            if one not in self._ready:
                number = next(self._numbers)
                self._ready[one] = now_s, number
                heappush(self._by_size, (self._size(one), number, one))

    def take(self, now_s: float) -> T | None:
        """Return the first of those found due, and forget it until it is woken or given a time again."""
        if not self._ready:
            return None
        first = next(iter(self._ready))
        if min(now_s - self._ready[first][0], now_s - self._relieved_s) > _PATIENCE_S:
            self._relieved_s = now_s
        else:
            _, number, first = heappop(self._by_size)
            while self._ready.get(first, _TAKEN)[1] != number:  # it was taken because it had waited longest
                _, number, first = heappop(self._by_size)
        del self._ready[first]
        return first

    def set(self, one: T, due_s: float) -> None:
        """Set when one that was just taken is due again, ``inf`` = not before it is woken (s)."""
        if due_s == math.inf or self._due_s.get(one) == due_s:
            return
        self._due_s[one] = due_s
        heappush(self._by_time, (due_s, next(self._numbers), one))
        if len(self._by_time) > _MOST_OUTDATED + 2 * len(self._due_s):  # some are woken often, long before their time
            self._by_time = [(at_s, next(self._numbers), each) for each, at_s in self._due_s.items()]
            heapify(self._by_time)

    def next_s(self) -> float:
        """Return when the next one is due, ``inf`` = none is (s)."""
        return -math.inf if self._ready else self._earliest_s()

    def _earliest_s(self) -> float:
        """Return the earliest due time, after forgetting the entries before it that no longer count (s)."""
        while self._by_time and self._due_s.get(self._by_time[0][2]) != self._by_time[0][0]:
            heappop(self._by_time)
        return self._by_time[0][0] if self._by_time else math.inf
