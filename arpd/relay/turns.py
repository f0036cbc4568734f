"""When the topics of an end may leave by their rates, found among a thousand in a few microseconds: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from arpd.endpoint.lane import Lane


class _Times:
    """When each lane may leave (s), the longest there first; lanes that wait for company stand apart."""

    def __init__(self) -> None:
        self._alone: dict[Lane, float] = {}
        self._together: dict[Lane, float] = {}

    def set(self, lane: Lane, due_s: float) -> None:
        here, other = (self._together, self._alone) if lane.has_company else (self._alone, self._together)
        here[lane] = due_s
        other.pop(lane, None)

    def drop(self, lane: Lane) -> None:
        self._alone.pop(lane, None)
        self._together.pop(lane, None)

    def due_s(self, departs_s: float) -> float:
        together_s = min(self._together.values(), default=math.inf)
        return min(min(self._alone.values(), default=math.inf), max(together_s, departs_s))

    def ready(self, now_s: float, departs_s: float) -> list[Lane]:
        alone = [lane for lane, due_s in self._alone.items() if due_s <= now_s]
        return alone + self.company(now_s) if departs_s <= now_s else alone

    def company(self, now_s: float) -> list[Lane]:
        return [lane for lane, due_s in self._together.items() if due_s <= now_s]


class Turns:
    """Keeps the times of all lanes that have something to send: asking each at every departure would cost milliseconds.

    The time of a lane changes only with its rates, its credit and what waits, so only lanes that were touched are asked
    again.

    Attributes
    ----------
    first : when small messages may leave, before large ones
    in_turn : when messages may leave that wait for what is left of the link
    finish : the virtual time at which each message would end
    """

    def __init__(self) -> None:
        self.first, self.in_turn = _Times(), _Times()
        self.finish: dict[Lane, float] = {}
        self._touched: dict[Lane, None] = {}

    def touch(self, lane: Lane) -> None:
        """Ask a lane again: its rates, or what waits there, are others now."""
        self._touched[lane] = None

    def move(self, lane: Lane) -> None:
        """Ask it again, and put it behind the others: it has something to send since now, or a message has left."""
        self._touched.pop(lane, None)
        self._touched[lane] = None
        self.first.drop(lane)
        self.in_turn.drop(lane)

    def update(self, active: Collection[Lane], now_s: float, *, finish: Callable[[Lane], float]) -> None:
        """Ask the lanes that were touched; ``active`` are those with something to send."""
        for lane in self._touched:
            if lane not in active:
                self.first.drop(lane)
                self.in_turn.drop(lane)
                self.finish.pop(lane, None)
                continue
            self.finish[lane] = finish(lane)
            if lane.is_small:
                self.first.set(lane, lane.due_s(now_s, in_turn=False))
            else:
                self.first.drop(lane)
            self.in_turn.set(lane, -math.inf if lane.current is not None else lane.due_s(now_s, in_turn=True))
        self._touched.clear()
