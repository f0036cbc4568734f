"""Whether a silent peer means a silent link."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.interface import LinkCounters

_LATELY_S = 0.3
_USUAL_S = 5.0  # time constant of what is usual
_LEAST_HZ = 30.0  # packets; fewer tell nothing within `_LATELY_S`, and some are the peer's own reports
_PART = 0.5  # of the usual


class Hearing:
    """Tells a peer that has died from a link that carries nothing: over one that works, readers go on to acknowledge.

    What counts is packets that the interface receives, beside how many it received while the peer was heard. Too few
    of them tell nothing, and the link is then taken for silent.
    """

    def __init__(self) -> None:
        self._looks: deque[tuple[float, int]] = deque()  # when s, packets received
        self._usual_hz = 0.0

    def note(self, now_s: float, counters: LinkCounters | None, *, is_usual: bool) -> None:
        """Look at the interface.

        Parameters
        ----------
        is_usual : whether the peer is heard
        """
        if counters is None or not counters.is_up:
            self._looks.clear()
            return
        if is_usual and self._looks and (elapsed_s := now_s - self._looks[-1][0]) > 0:
            rate_hz = (counters.rx_packets - self._looks[-1][1]) / elapsed_s
            self._usual_hz += (1.0 - math.exp(-elapsed_s / _USUAL_S)) * (rate_hz - self._usual_hz)
        self._looks.append((now_s, counters.rx_packets))
        while len(self._looks) > 1 and now_s - self._looks[1][0] >= _LATELY_S:
            self._looks.popleft()

    @property
    def is_answered(self) -> bool:
        """Whether about as many packets as usual arrived lately."""
        if not self._looks or (span_s := self._looks[-1][0] - self._looks[0][0]) < 0.5 * _LATELY_S:
            return False
        lately_hz = (self._looks[-1][1] - self._looks[0][1]) / span_s
        return self._usual_hz >= _LEAST_HZ and lately_hz >= _PART * self._usual_hz
