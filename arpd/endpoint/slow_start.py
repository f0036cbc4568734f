"""The first large samples of a topic, while nobody has planned it: pure."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.endpoint.lane import SMALL_BYTES, Lane

if TYPE_CHECKING:
    from collections.abc import Callable

POLL_S = 0.005
# A node finds a daemon, or is found, by an announcement every 3 s; then there is a price within a second.
_PATIENCE_S = 5.0
_QUICK_S = 0.1  # two heartbeats of arpd's profile: a link that acknowledges so soon keeps up


class SlowStart:
    """Lets a large sample leave when the readers have the one before, as TCP begins with a small window (RFC 5681).

    Nobody knows the link yet, and a camera that starts on a slow one fills every queue with what DDS then sends again
    and again. Up to DEPTH samples wait, as in DDS; once a daemon is there, the newest. A link that acknowledges quickly
    delays none. It ends with the first plan, or when the patience does.

    Parameters
    ----------
    lane : of the topic, for its plan and price
    is_acknowledged : returns whether the readers have all that was written
    depth : most samples that wait
    is_off : whether all leave as they come, because none may be left out

    Attributes
    ----------
    waiting : samples, the oldest first
    """

    def __init__(self, lane: Lane, is_acknowledged: Callable[[], bool], *, depth: int, is_off: bool) -> None:
        self._lane, self._is_acknowledged = lane, is_acknowledged
        self._depth, self.is_off = depth, is_off
        self.waiting: deque[bytes] = deque()
        self._until_s = math.inf
        self._behind_s = -math.inf  # since when a sample is not acknowledged
        self._is_quick = False

    def offer(self, sample: bytes, now_s: float) -> int:
        """Let a sample wait for its turn; return how many it replaces."""
        self._until_s = min(self._until_s, now_s + _PATIENCE_S)
        self.waiting.append(sample)
        replaced = 0
        while len(self.waiting) > self._most(now_s):
            self.waiting.popleft()
            replaced += 1
        return replaced

    def take(self, now_s: float) -> bytes | None:
        """Return the sample that leaves now."""
        if not self.waiting:
            return None
        if len(self.waiting[0]) > SMALL_BYTES and not self._is_over(now_s):
            if self._is_acknowledged():
                self._is_quick, self._behind_s = now_s - self._behind_s <= _QUICK_S, now_s
            elif not self._is_quick or now_s - self._behind_s > _QUICK_S:
                return None
        return self.waiting.popleft()

    def _most(self, now_s: float) -> float:
        if self._is_over(now_s):
            return math.inf  # they leave at once
        return self._depth if self._lane.price is None else 1

    def _is_over(self, now_s: float) -> bool:
        lane = self._lane
        return lane.plan.wire_bytes > 0.0 or now_s >= (self._until_s if lane.price is None else lane.unbound_s)
