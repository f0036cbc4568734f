"""Memory of the robot computer: depths fall with it at once, and rise late."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.allocation import Binding

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.plan import QosPlan

_EXCESS = 0.1  # of what the plan's histories may take; less is not worth swaps
_SPACING_S = 1.0  # between two falls, so memory that runs out causes few swaps
_ROOM = 0.25  # beyond what the plan's histories may take
_CALM_S = 30.0  # time with so much room before depths rise
_MOST_CALM_S = 480.0
_RELAPSE_S = 120.0  # after a fall so soon after a rise, the next rise waits longer


class MemoryWatch:
    """Compares what the histories under the plan in force may take with what the program gives them.

    A fall keeps the robot from running out of memory, so it waits for nothing. A rise is a convenience, and a shortage
    of memory tends to return, so it waits for calm, each time longer.
    """

    def __init__(self) -> None:
        self._is_short = False
        self._room_since_s: float | None = None
        self._calm_s = _CALM_S
        self._fell_s = self._rose_s = -math.inf

    def calls_for_depths(
        self, now_s: float, allocation: Allocation, topics: Sequence[Topic], plan: QosPlan, *, silent: Collection[str]
    ) -> bool:
        """Return whether a plan should take the depths of the allocation now; silent topics fill no history."""
        rows = [
            (topic.slot_bytes, plan.topics[topic.name].depth, given.depth_applied)
            for topic, given in zip(topics, allocation.topics, strict=True)
            if topic.name in plan.topics and topic.name not in silent
        ]
        taken = sum(slot * depth for slot, depth, _ in rows)
        excess = sum(slot * (depth - less) for slot, depth, less in rows if depth > less)
        room = sum(slot * (more - depth) for slot, depth, more in rows if more > depth)
        if _is_bound(allocation) and excess > _EXCESS * taken:
            self._room_since_s = None
            return now_s - self._fell_s >= _SPACING_S
        if not self._is_short or room - excess <= _ROOM * taken:
            self._room_since_s = None
            return False
        if self._room_since_s is None:
            self._room_since_s = now_s
        return now_s - self._room_since_s >= self._calm_s

    def note_depths(self, now_s: float, allocation: Allocation) -> None:
        """Note that the plan has these depths now because memory called for them."""
        if self._room_since_s is not None:
            self._rose_s = now_s
        else:
            if self._rose_s > self._fell_s:  # the first of several falls
                has_relapsed = now_s - self._rose_s < _RELAPSE_S
                self._calm_s = min(2 * self._calm_s, _MOST_CALM_S) if has_relapsed else _CALM_S
            self._fell_s = now_s
        self.note_plan(allocation)

    def note_plan(self, allocation: Allocation) -> None:
        """Note a plan with these depths, from any cause."""
        self._room_since_s = None
        self._is_short = _is_bound(allocation)


def _is_bound(allocation: Allocation) -> bool:
    return any(row.depth_binding is Binding.MEMORY for row in allocation.topics)
