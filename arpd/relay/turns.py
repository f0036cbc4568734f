"""When the topics of an end may leave by their rates, found among a thousand in a few microseconds: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.endpoint.queue import Times

if TYPE_CHECKING:
    from collections.abc import Callable

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

    def of(self, lane: Lane) -> Times:
        """Return where the time of a lane stands."""
        return self.together if lane.has_company else self

    @property
    def due_s(self) -> float:
        """When the first one may leave, ``inf`` = there is none (s)."""
        return min(super().due_s, self.together_s)

    @property
    def together_s(self) -> float:
        """When the first one of those that wait for company may (s)."""
        return max(self.together.due_s, self.departs_s)

    def ready(self, now_s: float) -> list[Lane]:
        """Return the lanes that may leave now, those that wait for nobody first."""
        alone = super().ready(now_s)
        return alone + self.together.ready(now_s) if self.departs_s <= now_s else alone


class Turns:
    """Keeps the times of all lanes that have something to send: asking each at every departure would cost milliseconds.

    The time of a lane changes only with its rates, its credit and what waits, so only lanes that were touched are asked
    again.

    Parameters
    ----------
    finish_of : computes the virtual time at which a lane's message would end

    Attributes
    ----------
    first : when small messages may leave, before large ones
    in_turn : when messages may leave that wait for what is left of the link
    finish : the virtual time of each lane
    """

    def __init__(self, finish_of: Callable[[Lane], float]) -> None:
        self.first, self.in_turn = KeptTimes(), KeptTimes()
        self.finish: dict[Lane, float] = {}
        self._finish_of = finish_of
        self._touched: dict[Lane, None] = {}

    def touch(self, *lanes: Lane) -> None:
        """Ask lanes again: their rates, or what waits there, are others now. New ones come behind the others."""
        self._touched |= dict.fromkeys(lanes)

    def drop(self, lane: Lane) -> None:
        """Forget a lane, which has nothing to send, or comes behind the others from now on."""
        for times in (self._touched, self.finish, self.first.of(lane), self.in_turn.of(lane)):
            times.pop(lane, None)

    def update(self, now_s: float) -> None:
        """Ask the lanes that were touched."""
        for lane in self._touched:
            self.finish[lane] = self._finish_of(lane)
            self.first.of(lane)[lane] = lane.first_s(now_s)
            self.in_turn.of(lane)[lane] = lane.spare_s(now_s)
        self._touched.clear()
