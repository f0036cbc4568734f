"""Rate limits on messages from the network, and on lines in the log."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable

_MOST_SOURCES = 1000  # as many nodes as any robot has


class RateLimit:
    """Lets so much of every source through in each period, so a sender that floods takes nothing from the others.

    Sources are bounded: while more send in a period than that, those that come late count as one.
    """

    def __init__(self, most: float, *, period_s: float, most_sources: int = _MOST_SOURCES) -> None:
        self._most, self._period_s, self._most_sources = most, period_s, most_sources
        self._ends_s = -math.inf
        self._passed: dict[Hashable, float] = defaultdict(float)

    def take(self, source: Hashable, now_s: float) -> bool:
        """Return whether one more of a source may pass now."""
        if now_s >= self._ends_s:
            self._ends_s = now_s + self._period_s
            self._passed.clear()
        if source not in self._passed and len(self._passed) >= self._most_sources:
            source = None
        self._passed[source] += 1
        return self._passed[source] <= self._most

    def charge(self, source: Hashable, more: float) -> None:
        """Let what a source has just had counted as one count for more."""
        self._passed[source if source in self._passed else None] += more


class OncePerMinute(RateLimit):
    """Picks what is worth a line in the log: each thing once a minute, and 33 things in that time."""

    def __init__(self) -> None:
        super().__init__(1, period_s=60.0, most_sources=32)  # invented names must not fill the log
