"""Limits that keep the decision log from flooding: a quota per minute, and conditions that flicker."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

_SPAN_S = 60.0


class Quota:
    """Lets so many pass in any minute and counts the rest; nothing more passes until that count has been told.

    Parameters
    ----------
    most : number that pass in a minute
    """

    def __init__(self, most: int) -> None:
        self._passed_s: deque[float] = deque(maxlen=most)
        self._untold_since_s = 0.0
        self.untold = 0

    def take(self, now_s: float) -> bool:
        """Return whether one more may pass now; otherwise count it."""
        if self.untold or self._is_full(now_s):
            if not self.untold:
                self._untold_since_s = now_s
            self.untold += 1
            return False
        self._passed_s.append(now_s)
        return True

    def settle(self, now_s: float) -> int:
        """Return how many did not pass, once a minute is over and there is room to say so; 0 until then."""
        if not self.untold or now_s - self._untold_since_s < _SPAN_S or self._is_full(now_s):
            return 0
        self._passed_s.append(now_s)
        untold, self.untold = self.untold, 0
        return untold

    def _is_full(self, now_s: float) -> bool:
        passed = self._passed_s
        return len(passed) == passed.maxlen and now_s - passed[0] < _SPAN_S


@dataclass(frozen=True, kw_only=True, slots=True)
class Turn:
    """The begin or end of a condition, to be told.

    Parameters
    ----------
    holds : True for a begin
    lasted_s : how long the other state lasted (s)
    untold : how often it began since the last one that was told, without this one
    """

    holds: bool
    lasted_s: float = 0.0
    untold: int = 0


class Episode:
    """A condition that begins and ends; begins beyond the quota, and their ends, are only counted.

    The count tells the present state, too, so the last thing told is always true after a while.

    Parameters
    ----------
    hold_s : how long a change must last to be one (s)
    most : begins logged per minute

    Attributes
    ----------
    holds : True while the condition holds, short changes left out
    """

    def __init__(self, *, hold_s: float = 0.0, most: int = 3) -> None:
        self._hold_s = hold_s
        self._quota = Quota(most)
        self.holds = False
        self._told = False
        self._since_s: float | None = None  # of the present state
        self._differs_since_s: float | None = None

    def look(self, now_s: float, *, holds: bool) -> Turn | None:
        """Take in whether the condition holds now; return what is to be told, None when there is nothing."""
        if holds == self.holds:
            self._differs_since_s = None
            return self._count(now_s)
        if self._differs_since_s is None:
            self._differs_since_s = now_s
        if now_s - self._differs_since_s < self._hold_s:
            return self._count(now_s)
        began_s, self._differs_since_s = self._differs_since_s, None
        lasted_s = began_s - self._since_s if self._since_s is not None else 0.0
        self.holds, self._since_s = holds, began_s
        if holds:
            self._told = self._quota.take(now_s)
        return Turn(holds=holds, lasted_s=lasted_s) if self._told else None

    def _count(self, now_s: float) -> Turn | None:
        if not (untold := self._quota.settle(now_s)):
            return None
        self._told = self.holds
        return Turn(holds=self.holds, untold=untold)
