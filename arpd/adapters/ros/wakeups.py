"""Due times of the publishers of one node, and the order in which the pacing thread serves them."""

from __future__ import annotations

import math
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_PATIENCE_S = 1.0

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
        self._ready: dict[T, float] = {}  # those found due, with the time they were found, oldest first
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
            self._due_s[woken] = -math.inf

    def look(self, now_s: float) -> None:
        """Find those that are due."""
        try:
            while True:
                if (woken := self._woken.get_nowait()) is not None:
                    self._due_s[woken] = -math.inf
        except Empty:
            pass
        for one in [one for one, due_s in self._due_s.items() if due_s <= now_s]:
            del self._due_s[one]
            self._ready.setdefault(one, now_s)

    def take(self, now_s: float) -> T | None:
        """Return the first of those found due, and forget it until it is woken or given a time again."""
        if not self._ready:
            return None
        first = next(iter(self._ready))
        if min(now_s - self._ready[first], now_s - self._relieved_s) > _PATIENCE_S:
            self._relieved_s = now_s
        else:
            first = min(self._ready, key=self._size)
        del self._ready[first]
        return first

    def set(self, one: T, due_s: float) -> None:
        """Set when one that was just taken is due again, ``inf`` = not before it is woken (s)."""
        if due_s < math.inf:
            self._due_s[one] = due_s

    def next_s(self) -> float:
        """Return when the next one is due, ``inf`` = none is (s)."""
        return -math.inf if self._ready else min(self._due_s.values(), default=math.inf)
