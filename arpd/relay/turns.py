"""When the topics of an end may leave by their rates, found among a thousand in a few microseconds: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.endpoint.queue import Times

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from arpd.endpoint.lane import Lane


class KeptTimes(Times):
    """When each lane may leave, the longest there first.

    Attributes
    ----------
    together : the same of lanes that wait for company, which stand there alone
    departs_s : when these may leave at the earliest (s)
    """

    def __init__(self) -> None:
        super().__init__()
        self.together, self.departs_s = Times(), -math.inf

    def set(self, lane: Lane, due_s: float) -> None:
        """Keep when a lane may leave (s)."""
        here, other = (self.together, self) if lane.has_company else (self, self.together)
        here[lane] = due_s
        other.pop(lane, None)

    def drop(self, lane: Lane) -> None:
        """Forget a lane."""
        self.pop(lane, None)
        self.together.pop(lane, None)

    @property
    def due_s(self) -> float:
        """When the first one may leave, ``inf`` = there is none (s)."""
        return min(super().due_s, max(self.together.due_s, self.departs_s))

    def ready(self, now_s: float) -> list[Lane]:
        """Return the lanes that may leave now, those that wait for nobody first."""
        alone = super().ready(now_s)
        return alone + self.together.ready(now_s) if self.departs_s <= now_s else alone


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
        self.first, self.in_turn = KeptTimes(), KeptTimes()
        self.finish: dict[Lane, float] = {}
        self._touched: dict[Lane, None] = {}

    def touch(self, *lanes: Lane) -> None:
        """Ask lanes again: their rates, or what waits there, are others now."""
        self._touched |= dict.fromkeys(lanes)

    def move(self, lane: Lane) -> None:
        """Ask it again, and put it behind the others: it has something to send since now, or a message has left."""
        self._touched.pop(lane, None)
        self._touched[lane] = None
        self.first.drop(lane)
        self.in_turn.drop(lane)

    def wait_for_company(self, departs_s: float) -> None:
        """Let the messages that leave together wait until then (s)."""
        self.first.departs_s = self.in_turn.departs_s = departs_s

    def update(self, active: Collection[Lane], now_s: float, *, finish: Callable[[Lane], float]) -> None:
        """Ask the lanes that were touched; ``active`` are those with something to send."""
        for lane in self._touched:
            if lane not in active:
                self.first.drop(lane)
                self.in_turn.drop(lane)
                self.finish.pop(lane, None)
                continue
            self.finish[lane] = finish(lane)
            self.first.set(lane, lane.first_s(now_s))
            self.in_turn.set(lane, lane.spare_s(now_s))
        self._touched.clear()
