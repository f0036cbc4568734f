"""What stands before a link, told from what only passes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

_STANDING_S = 0.08
_LEAST_RATE = 0.05  # of what is believed of the link: a queue nothing leaves is long, and not endless


@dataclass(frozen=True, slots=True)
class _Look:
    at_s: float
    waiting_bytes: float
    left_bytes: float


class StandingBacklog:
    """Looks at what waits before a link; what stands is the least of what was seen lately.

    Messages of many topics that meet come and go within a look or two.

    Parameters
    ----------
    fresh_s : looks that are older, or further apart, say nothing of now (s)
    """

    def __init__(self, *, fresh_s: float = math.inf) -> None:
        self._fresh_s = fresh_s
        self._looks: deque[_Look] = deque()

    def note(self, now_s: float, *, waiting_bytes: float, left_bytes: float) -> None:
        """Note a look.

        Parameters
        ----------
        waiting_bytes : what waits (bytes)
        left_bytes : what has left since the look before (bytes)
        """
        self._looks.append(_Look(now_s, waiting_bytes, left_bytes))
        # As many looks as it takes to tell what stands from what passes.
        while len(self._looks) > 1 and now_s - self._looks[1].at_s >= _STANDING_S:
            self._looks.popleft()

    def clear(self) -> None:
        """Forget every look."""
        self._looks.clear()

    def delay_s(self, now_s: float, *, burst_bytes: float, capacity_bytes_per_second: float) -> float:
        """Return how long what waits will take to leave; 0 while it may be a burst of messages (s).

        Parameters
        ----------
        burst_bytes : what may stand there without being a queue
        capacity_bytes_per_second : what is believed of the link
        """
        looks = self._looks
        if not looks or now_s - looks[-1].at_s > self._fresh_s:
            return 0.0
        span_s = looks[-1].at_s - looks[0].at_s
        if not _STANDING_S <= span_s <= self._fresh_s or min(look.waiting_bytes for look in looks) <= burst_bytes:
            return 0.0
        rate = (sum(look.left_bytes for look in looks) - looks[0].left_bytes) / span_s
        return looks[-1].waiting_bytes / max(rate, _LEAST_RATE * capacity_bytes_per_second)
