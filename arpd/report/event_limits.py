"""What keeps something that comes and goes from filling a log: quotas, and conditions that must last."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

_SPAN_S = 60.0


class Quota:
    """So many in any minute, and a count of what was over it; until that is told, nothing more passes.

    Parameters
    ----------
    most : that pass in a minute
    """

    def __init__(self, most: int) -> None:
        self._passed_s: deque[float] = deque(maxlen=most)
        self._untold_since_s = 0.0
        self.untold = 0

    def take(self, now_s: float) -> bool:
        """Whether one more may pass now; if not, it is counted."""
        if self.untold or self._is_full(now_s):
            if not self.untold:
                self._untold_since_s = now_s
            self.untold += 1
            return False
        self._passed_s.append(now_s)
        return True

    def settle(self, now_s: float) -> int:
        """Return how many did not pass, once there is room to say so: a minute of them is told as one."""
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
    """A condition that began or ended and is to be told.

    Parameters
    ----------
    holds : whether it holds now
    lasted_s : how long the other state lasted (s)
    untold : how often it began since without being told, this turn left out
    """

    holds: bool
    lasted_s: float = 0.0
    untold: int = 0


class Episode:
    """A condition that begins and ends, told both times; a beginning beyond the quota, and its end, are only counted.

    What was told last is never left standing when it is no longer so: the count tells the state along with it.

    Parameters
    ----------
    hold_s : how long a change must last to be one (s)
    most : beginnings that are told in a minute

    Attributes
    ----------
    holds : whether the condition holds, by what it was told
    """

    def __init__(self, *, hold_s: float = 0.0, most: int = 3) -> None:
        self._hold_s = hold_s
        self._quota = Quota(most)
        self.holds = False
        self._told = False
        self._since_s: float | None = None  # of the present state
        self._differs_since_s: float | None = None

    def look(self, now_s: float, *, holds: bool) -> Turn | None:
        """Take in whether the condition holds now, and return what is to be told, if anything."""
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
