"""Virtual time: a clock that jumps from event to event."""

from __future__ import annotations

import math
from functools import partial
from heapq import heappop, heappush
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Timeline:
    """Virtual time: runs the earliest event first, and events of one moment in the order of their planning.

    Parameters
    ----------
    now_s : start of time (s)
    """

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s
        self._planned = 0
        self._events: list[tuple[float, int, Callable[[], object]]] = []

    def at(self, when_s: float, action: Callable[[], object]) -> None:
        """Plan an action; an action in the past runs now."""
        self._planned += 1
        heappush(self._events, (when_s, self._planned, action))

    def every(self, period_s: float, action: Callable[[], None], *, first_s: float) -> None:
        """Plan a periodic action without drift."""
        count = 0

        def again() -> None:
            nonlocal count
            action()
            count += 1
            self.at(first_s + count * period_s, again)

        self.at(first_s, again)

    def run_until(self, end_s: float) -> None:
        """Run all events before ``end_s``."""
        events = self._events
        while events and events[0][0] < end_s:
            when_s, _, action = heappop(events)
            self.now_s = max(self.now_s, when_s)
            action()
        self.now_s = max(self.now_s, end_s)


class Alarm:
    """One action at one moment, which can be moved.

    Parameters
    ----------
    action : runs at the moment
    """

    def __init__(self, timeline: Timeline, action: Callable[[], object]) -> None:
        self._timeline = timeline
        self._action = action
        self._setting = 0
        self.when_s = math.inf

    def set(self, when_s: float) -> None:
        """Move the moment; a moment in the past is now."""
        self._setting += 1
        self.when_s = when_s = max(when_s, self._timeline.now_s)
        self._timeline.at(when_s, partial(self._fire, self._setting))

    def set_by(self, when_s: float) -> None:
        """Move the moment if that is sooner."""
        if when_s < self.when_s:
            self.set(when_s)

    def _fire(self, setting: int) -> None:
        if setting == self._setting:
            self.when_s = math.inf
            self._action()
