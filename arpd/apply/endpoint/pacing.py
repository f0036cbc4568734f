"""Pacing of one publisher: a token bucket decides when a sample leaves, and which one is dropped."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.endpoints import DropCause
from arpd.model.settings import Overflow

if TYPE_CHECKING:
    from collections.abc import Callable

# A source at its paced rate may be early by half a period, or catch up on 50 ms that its scheduler cost, and is not
# delayed. No window of T seconds sees more than rate·T + max(1.5, rate·50 ms) samples.
_LEAST_BURST = 1.5
_BURST_S = 0.05


class Pacer:
    """A bounded queue, emptied by a token bucket.

    It counts credit in samples, so a change of rate leaves the credit as it is: a gate that moves ten times a second
    neither releases a sample early nor keeps an old schedule.

    Parameters
    ----------
    overflow : which samples are dropped when they come faster than they may leave
    depth : most samples the queue holds (samples); ``latest`` holds one
    on_withheld : called with the number of dropped samples and the cause, once per call that drops any

    Notes
    -----
    Not thread-safe; the publisher's lock guards it. Times are seconds of one monotonic clock.
    """

    def __init__(self, *, overflow: Overflow, depth: int, on_withheld: Callable[[int, DropCause], None]) -> None:
        self._overflow = overflow
        self._on_withheld = on_withheld
        self._depth = depth
        self._rate_hz = math.inf
        self._limit = DropCause.RATE
        self._credit = _LEAST_BURST
        self._at_s = -math.inf
        self._queue: deque[bytes] = deque()

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def rate_hz(self) -> float:
        """Rate in force, ``inf`` = unpaced (Hz)."""
        return self._rate_hz

    def retune(self, *, rate_hz: float, depth: int, now_s: float, limit: DropCause = DropCause.RATE) -> None:
        """Change rate and queue bound at once; credit earned so far stays.

        Parameters
        ----------
        limit : cause of the drops from now on, `rate` or `gate`, by the origin of this rate
        """
        self._earn(now_s)
        self._rate_hz = rate_hz
        self._limit = limit
        self._depth = depth
        self._shed()

    def offer(self, sample: bytes, now_s: float) -> None:
        """Queue a sample; ``latest`` keeps only the newest, ``queue`` drops the oldest beyond the depth."""
        self._earn(now_s)
        self._queue.append(sample)
        self._shed()

    def admits(self, now_s: float) -> bool:
        """Return whether a sample may leave without being queued, and spend its credit."""
        if self._queue:
            return False
        self._earn(now_s)
        if self._credit < 1.0 or self._rate_hz <= 0:
            return False
        self._credit -= 1.0
        return True

    def due_s(self, now_s: float) -> float:
        """Return when the next queued sample may leave; ``inf`` when none waits or the topic is paused (s)."""
        if not self._queue or self._rate_hz <= 0:
            return math.inf
        self._earn(now_s)
        if self._credit >= 1.0:
            return now_s
        return now_s + (1.0 - self._credit) / self._rate_hz

    def take(self, now_s: float) -> bytes | None:
        """Return the next sample if it may leave now, and spend its credit."""
        if self.due_s(now_s) > now_s:
            return None
        self._credit -= 1.0
        return self._queue.popleft()

    def clear(self) -> None:
        """Drop everything that waits, counted as withheld."""
        withheld = len(self._queue)
        self._queue.clear()
        if withheld:
            self._on_withheld(withheld, DropCause.CLOSED)

    def _earn(self, now_s: float) -> None:
        if math.isinf(self._rate_hz):
            self._credit = _LEAST_BURST
        elif now_s > self._at_s:
            self._credit = min(self._most_credit, self._credit + self._rate_hz * (now_s - self._at_s))
        self._at_s = max(self._at_s, now_s)

    @property
    def _most_credit(self) -> float:
        return _LEAST_BURST if math.isinf(self._rate_hz) else max(_LEAST_BURST, _BURST_S * self._rate_hz)

    def _shed(self) -> None:
        bound = self._depth
        if self._overflow is Overflow.LATEST and not math.isinf(self._rate_hz):
            # Samples that have credit wait only for the thread that writes them, as unpaced ones do: keep those.
            bound = max(1, int(self._credit))
        excess = len(self._queue) - bound
        if excess > 0:
            for _ in range(excess):
                self._queue.popleft()
            # At full credit the next sample has been due for at least half a period, so pacing does not hold it.
            is_due = self._rate_hz > 0 and self._credit >= self._most_credit
            self._on_withheld(excess, DropCause.BLOCKED if is_due else self._limit)
