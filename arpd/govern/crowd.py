"""Topics that come and go: when a plan should follow them."""

from __future__ import annotations

import math


class Crowd:
    """Says when topics that came or went get a plan: once no more do, and at the latest after the dwell.

    From the second one on, a plan soon after another one waits twice as long, up to the dwell. So a graph that grows
    for a minute makes some plans, and not one per second. A topic that comes after two dwells of quiet is planned soon.
    """

    def __init__(self) -> None:
        self._crowd: object = None
        self._same_since_s = self._planned_at_s = -math.inf
        self._differs_since_s = math.inf
        self._wait_s = 0.0

    def is_settled(self, now_s: float, crowd: object, debounce_s: float, dwell_s: float) -> bool:
        """Return whether a crowd other than the planned one has settled, or has waited long enough."""
        if crowd != self._crowd:
            self._crowd, self._same_since_s = crowd, now_s
        if math.isinf(self._differs_since_s):
            self._differs_since_s = now_s
            is_growing = now_s - self._planned_at_s < 2 * dwell_s
            self._wait_s = min(dwell_s, 2 * self._wait_s) if is_growing else 0.5 * debounce_s
        return now_s - self._same_since_s >= max(debounce_s, self._wait_s) or now_s - self._differs_since_s >= dwell_s

    def note_same(self) -> None:
        """Note that the plan in force has all topics."""
        self._differs_since_s = math.inf

    def note_plan(self, now_s: float) -> None:
        """Note a plan whose topics are others than before."""
        self._planned_at_s = now_s
        self.note_same()
