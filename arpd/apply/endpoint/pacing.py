"""Pacing of one publisher: when a sample may leave, and which samples give way when it may not."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.endpoints import DropCause
from arpd.model.settings import Overflow

if TYPE_CHECKING:
    from collections.abc import Callable

# A source at its paced rate that is early by half a period, or that catches up on 50 ms of its own scheduling, is not
# delayed; no window of T seconds ever sees more than rate·T + max(1.5, rate·50 ms) samples.
_LEAST_BURST = 1.5
_BURST_S = 0.05


class Pacer:
    """A token bucket in front of a bounded queue.

    Credit is counted in samples, so that it survives a change of rate as it is: a gate that moves ten times a second
    must neither release a sample early nor keep an old schedule.

    Parameters
    ----------
    overflow : what gives way when samples come faster than they may leave
    depth : most samples the queue holds (samples); ``latest`` holds one
    on_withheld : called with the number of samples given up and why, once per call that gives any up

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
        limit : what the rate comes from, `rate` or `gate`: the cause of what it makes give way
        """
        self._earn(now_s)
        self._rate_hz = rate_hz
        self._limit = limit
        self._depth = depth
        self._shed()

    def offer(self, sample: bytes, now_s: float) -> None:
        """Queue a sample; with ``latest`` it replaces what must wait, with ``queue`` the oldest beyond depth goes."""
        self._earn(now_s)
        self._queue.append(sample)
        self._shed()

    def admits(self, now_s: float) -> bool:
        """Whether a sample may leave without being queued; its credit is spent then."""
        if self._queue:
            return False
        self._earn(now_s)
        if self._credit < 1.0 or self._rate_hz <= 0:
            return False
        self._credit -= 1.0
        return True

    def due_s(self, now_s: float) -> float:
        """When the next queued sample may leave (s); ``inf`` when none waits or the topic is paused."""
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
        """Give up everything that waits, counted as withheld."""
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
        # What may leave at once is not waiting for credit, only for the thread that writes it.
        bound = max(1, int(self._credit)) if self._overflow is Overflow.LATEST else self._depth
        if math.isinf(self._rate_hz) and self._overflow is Overflow.LATEST:
            bound = self._depth  # unpaced samples wait only for the thread that writes them: lose none of them
        excess = len(self._queue) - bound
        if excess > 0:
            for _ in range(excess):
                self._queue.popleft()
            # With all the credit there can be, what waits has been due for half a period at least.
            is_due = self._rate_hz > 0 and self._credit >= self._most_credit
            self._on_withheld(excess, DropCause.BLOCKED if is_due else self._limit)
