"""Memory of the robot computer: depths fall with it at once, and rise late."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.govern.patience import Patience
from arpd.model.allocation import Binding

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.plan import QosPlan

_EXCESS = 0.1  # of what the plan's histories may take; less is not worth swaps
_SPACING_S = 1.0  # between two falls, so memory that runs out causes few swaps
_ROOM = 0.25  # beyond what the plan's histories may take
_CALM_S = 30.0  # time with so much room before depths rise


class MemoryWatch:
    """Compares what the histories under the plan in force may take with what the program gives them.

    A fall keeps the robot from running out of memory, so it waits for nothing. A rise is a convenience, and a shortage
    of memory tends to return, so it waits for calm, each time longer.

    Attributes
    ----------
    is_short : True when memory limited the depths of the last plan
    """

    def __init__(self) -> None:
        self.is_short = False
        self._room_since_s: float | None = None
        self._patience = Patience()

    def calls_for_depths(
        self,
        now_s: float,
        allocation: Allocation,
        topics: Sequence[Topic],
        plan: QosPlan,
        *,
        depths: Callable[[], Mapping[str, int]],
        silent: Collection[str],
    ) -> bool:
        """Return whether a plan should take the depths of the allocation now; silent topics fill no history.

        Parameters
        ----------
        depths : returns the depths of the allocation, in their classes
        """
        if not (self.is_short or _is_bound(allocation)):
            self._room_since_s = None
            return False
        given = depths()
        rows = [
            (topic.slot_bytes, plan.topics[topic.name].depth, given[topic.name])
            for topic in topics
            if topic.name in plan.topics and topic.name not in silent
        ]
        taken = sum(slot * depth for slot, depth, _ in rows)
        excess = sum(slot * (depth - less) for slot, depth, less in rows if depth > less)
        room = sum(slot * (more - depth) for slot, depth, more in rows if more > depth)
        if _is_bound(allocation) and excess > _EXCESS * taken:
            self._room_since_s = None
            return now_s - self._patience.fell_s >= _SPACING_S
        if not self.is_short or room - excess <= _ROOM * taken:
            self._room_since_s = None
            return False
        if self._room_since_s is None:
            self._room_since_s = now_s
        return now_s - self._room_since_s >= self._patience.factor * _CALM_S

    def note_depths(self, now_s: float, allocation: Allocation) -> None:
        """Note that the plan has these depths now because memory called for them."""
        if self._room_since_s is not None:
            self._patience.note_rise(now_s)
        else:
            self._patience.note_fall(now_s)
        self.note_plan(allocation)

    def note_plan(self, allocation: Allocation) -> None:
        """Note a plan with these depths, from any cause."""
        self._room_since_s = None
        self.is_short = _is_bound(allocation)


def _is_bound(allocation: Allocation) -> bool:
    return any(row.depth_binding is Binding.MEMORY for row in allocation.topics)
