"""The rate of samples."""

from __future__ import annotations

import math
from collections import deque

_WINDOW_S = 5.0
_SETTLE_S = 0.5  # a shorter span shows no rate
_BURST_S = 0.1  # after a stall the samples that waited come at once; the true rate shows after that
_SILENT_PERIODS = 3.0


class SampleRate:
    """Rate between the first and the last sample of a window, so that a slow topic is not underrated.

    One thread may `count` while another calls `mark` and `rate_hz`.
    """

    def __init__(self) -> None:
        self.samples = 0
        self._last_s = -math.inf
        self._began_s = -math.inf  # first sample after a silence
        self._marks: deque[tuple[float, int]] = deque()  # time, samples counted by then

    def count(self, now_s: float) -> None:
        """Count one sample."""
        self.samples += 1
        if now_s - self._last_s > _WINDOW_S:
            self._began_s = now_s
        if now_s - self._began_s < _BURST_S:
            # Measure from the first samples on: the silence before them says nothing about the rate.
            self._marks = deque([(now_s, self.samples)])
        self._last_s = now_s

    def mark(self, now_s: float) -> None:
        """Move the window on; called about once a second."""
        marks, samples = self._marks, self.samples  # the thread that counts may replace them meanwhile
        if marks and samples > marks[-1][1]:
            marks.append((self._last_s, samples))
        while len(marks) > 2 and now_s - marks[1][0] >= _WINDOW_S:
            marks.popleft()

    def rate_hz(self, now_s: float) -> float:
        """Return the rate, 0 when samples have stopped or their rate is not known yet (Hz)."""
        marks, total = self._marks, self.samples
        if not marks or total == marks[0][1]:
            return 0.0
        since_s, before = marks[0]
        last_s = self._last_s
        samples, span_s = total - before, last_s - since_s
        if now_s - last_s > _SILENT_PERIODS * span_s / samples + _SETTLE_S:
            return 0.0
        return samples / span_s if span_s > 0 and now_s - since_s >= _SETTLE_S else 0.0
