"""Whom the pacing thread is to visit, and when: only who is due, and whoever asked for it."""

from __future__ import annotations

import math
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class Visits(Generic[T]):
    """Due times of those who gave one, and a queue of those who want to be visited at once.

    Only `wake` and `end` may be called from other threads. Whoever is woken is due at once, and stays so until it is
    visited: a wake during the visit itself means another one.
    """

    def __init__(self) -> None:
        self._due_s: dict[T, float] = {}
        self._woken: SimpleQueue[T | None] = SimpleQueue()

    def wake(self, one: T) -> None:
        """Ask for a visit at once."""
        self._woken.put(one)

    def end(self) -> None:
        """Let `wait` return, for nobody's sake."""
        self._woken.put(None)

    def wait(self, for_s: float) -> None:
        """Wait until somebody is woken, or the time is over."""
        try:
            woken = self._woken.get(timeout=max(0.0, for_s))
            while True:
                if woken is not None:
                    self._due_s[woken] = -math.inf
                woken = self._woken.get_nowait()
        except Empty:
            return

    def take_due(self, now_s: float) -> list[T]:
        """Return who is due; each is forgotten until it is woken, or given a time again."""
        due = [one for one, due_s in self._due_s.items() if due_s <= now_s]
        for one in due:
            del self._due_s[one]
        return due

    def set(self, one: T, due_s: float) -> None:
        """Set when to visit one who was just taken, ``inf`` = not before it is woken (s)."""
        if due_s < math.inf:
            self._due_s[one] = due_s

    def next_s(self) -> float:
        """When the next one is due, ``inf`` = nobody (s)."""
        return min(self._due_s.values(), default=math.inf)
