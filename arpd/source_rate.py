"""How fast an application publishes, measured so that neither silence nor a slow period misleads."""

from __future__ import annotations

import math
from collections import deque

_WINDOW_S = 5.0
_SETTLE_S = 0.5  # a shorter look at a source tells no rate
_SILENT_PERIODS = 3.0


class SourceRate:
    """Rate between the first and the last sample of a window, so that a slow source is not underrated."""

    def __init__(self) -> None:
        self.samples = 0
        self._last_s = -math.inf
        self._marks: deque[tuple[float, int]] = deque()  # time, samples counted by then

    def count(self, now_s: float) -> None:
        """Count one sample."""
        self.samples += 1
        if now_s - self._last_s > _WINDOW_S:
            # The silence before a source starts says nothing of its rate: measure from its first sample on.
            self._marks = deque([(now_s, self.samples)])
        self._last_s = now_s

    def mark(self, now_s: float) -> None:
        """Let the window move on; called about once a second."""
        if self._marks and self.samples > self._marks[-1][1]:
            self._marks.append((self._last_s, self.samples))
        while len(self._marks) > 2 and now_s - self._marks[1][0] >= _WINDOW_S:
            self._marks.popleft()

    def rate_hz(self, now_s: float) -> float:
        """Return the rate, 0 for a source that is silent or not yet known (Hz)."""
        if not self._marks or self.samples == self._marks[0][1]:
            return 0.0
        since_s, before = self._marks[0]
        samples, span_s = self.samples - before, self._last_s - since_s
        if now_s - self._last_s > _SILENT_PERIODS * span_s / samples + _SETTLE_S:
            return 0.0
        return samples / span_s if span_s > 0 and now_s - since_s >= _SETTLE_S else 0.0
