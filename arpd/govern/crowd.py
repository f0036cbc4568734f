"""Topics that come and go: when a plan should follow them."""

from __future__ import annotations

import math


class Steady:
    """Time for which a value has stayed the same."""

    def __init__(self) -> None:
        self._value: object = None
        self._since_s = -math.inf

    def lasts_s(self, value: object, now_s: float) -> float:
        """Return for how long it has been this value (s)."""
        if value != self._value:
            self._value, self._since_s = value, now_s
        return now_s - self._since_s


class Crowd:
    """Says when new topics get a plan: once no more come, and at the latest after the dwell.

    After each such plan the next one waits twice as long, from the debounce up to the dwell. So a graph that grows for
    a minute makes some plans, and not one per second. A topic that comes after two dwells of quiet is planned soon.
    """

    def __init__(self) -> None:
        self._unchanged, self._differs = Steady(), Steady()
        self._planned_at_s = -math.inf
        self._pause_s = 0.0

    def is_settled(self, now_s: float, crowd: object, *, debounce_s: float, dwell_s: float) -> bool:
        """Return whether a crowd other than the planned one has settled, or has waited long enough."""
        unchanged_s = self._unchanged.lasts_s(crowd, now_s)
        waited_s = self._differs.lasts_s(True, now_s)  # noqa: FBT003 - the value to watch, not a switch
        return unchanged_s >= debounce_s or waited_s >= dwell_s

    def note_planned(self) -> None:
        """Note that the plan in force has all topics."""
        self._differs = Steady()

    def may_follow(self, now_s: float) -> bool:
        """Return whether the last plan for topics is long enough ago for another one."""
        return now_s - self._planned_at_s >= self._pause_s

    def note_plan(self, now_s: float, *, debounce_s: float, dwell_s: float) -> None:
        """Note a plan whose topics are others than before."""
        is_growing = now_s - self._planned_at_s < 2 * dwell_s
        self._pause_s = min(dwell_s, 2 * self._pause_s) if is_growing else min(dwell_s, debounce_s)
        self._planned_at_s = now_s
        self.note_planned()
