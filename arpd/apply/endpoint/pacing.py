"""Pacing of one publisher: a token bucket decides when a sample leaves, and which one is withheld."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.endpoints import WithheldCause
from arpd.model.settings import Overflow

if TYPE_CHECKING:
    from collections.abc import Callable

# A source at its paced rate may be early, wait for its turn on the link, or catch up on 50 ms that its scheduler cost,
# and loses nothing. No window of T seconds sees more than rate·T + max(2, rate·50 ms) samples.
_LEAST_BURST = 2.0
_BURST_S = 0.05
_FULL = 1.0 - 1e-9  # credit of one sample; sums of small parts may lack a few of the last digits
_PATIENCE = 1.5  # source periods that a sample waits for a fresher one: by then its source may have stopped
_GAP_WEIGHT = 0.1
_LONGEST_GAP_S = 5.0  # a longer one is a silence


class Pacer:
    """A bounded queue, emptied by a token bucket.

    It counts credit in samples, so a change of rate leaves the credit as it is: a price that moves ten times a second
    neither releases a sample early nor keeps an old schedule.

    With ``latest``, a sample that finds credit leaves on arrival. Credit that comes while an older sample waits is for
    the next arrival, which is fresher; only if none comes within 1.5 periods of the source, the older one leaves.

    Parameters
    ----------
    overflow : which samples are withheld when they come faster than they may leave
    depth : most samples the queue holds (samples); ``latest`` holds one
    on_withheld : called with the number of withheld samples and the cause, once per call that withholds any

    Notes
    -----
    Not thread-safe; the publisher's lock guards it. Times are seconds of one monotonic clock.
    """

    def __init__(
        self,
        *,
        overflow: Overflow,
        depth: int,
        on_withheld: Callable[[int, WithheldCause], None],
    ) -> None:
        self._overflow = overflow
        self._on_withheld = on_withheld
        self._depth = depth
        self._rate_hz = math.inf
        self._limit = WithheldCause.RATE
        self._credit = _LEAST_BURST
        self._at_s = -math.inf
        self._queue: deque[bytes] = deque()
        self._is_due = False  # the newest sample found credit, and waits only for the thread that writes it
        self._arrived_s = -math.inf
        self._gap_s = 0.0  # mean time between two samples of the source, 0 = not known yet

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def rate_hz(self) -> float:
        """Rate in force, ``inf`` = unpaced (Hz)."""
        return self._rate_hz

    def retune(self, *, rate_hz: float, depth: int, now_s: float, limit: WithheldCause = WithheldCause.RATE) -> None:
        """Change rate and queue bound at once; credit earned so far stays.

        Parameters
        ----------
        limit : why samples are withheld from now on, `rate` or `price`, by the origin of this rate
        """
        self._earn(now_s)
        self._rate_hz = rate_hz
        self._limit = limit
        self._depth = depth
        self._shed()

    def offer(self, sample: bytes, now_s: float) -> None:
        """Queue a sample; ``latest`` keeps only the newest, ``queue`` withholds the oldest beyond the depth."""
        self._earn(now_s)
        self._note_arrival(now_s)
        self._queue.append(sample)
        self._shed()
        self._is_due = self._credit >= _FULL and self._rate_hz > 0

    def admits(self, now_s: float) -> bool:
        """Return whether a sample may leave without being queued, and spend its credit."""
        if self._queue:
            return False
        if self._rate_hz != math.inf:  # unpaced, credit does not count
            self._earn(now_s)
            if self._credit < _FULL or self._rate_hz <= 0:
                return False
            self._credit -= 1.0
        self._note_arrival(now_s)
        return True

    def due_s(self, now_s: float) -> float:
        """Return when the next queued sample may leave; ``inf`` when none waits or the topic is paused (s)."""
        if not self._queue or self._rate_hz <= 0:
            return math.inf
        self._earn(now_s)
        due_s = now_s if self._credit >= _FULL else now_s + (1.0 - self._credit) / self._rate_hz
        if self._waits_for_fresher:
            return max(due_s, self._arrived_s + _PATIENCE * self._gap_s)
        return due_s

    def take(self, now_s: float) -> bytes | None:
        """Return the next sample if it may leave now, and spend its credit."""
        if self.due_s(now_s) > now_s:
            return None
        self._credit -= 1.0
        return self._queue.popleft()

    def clear(self) -> None:
        """Withhold everything that waits."""
        withheld = len(self._queue)
        self._queue.clear()
        if withheld:
            self._on_withheld(withheld, WithheldCause.CLOSED)

    def _note_arrival(self, now_s: float) -> None:
        gap_s = now_s - self._arrived_s
        self._arrived_s = now_s
        if 0.0 <= gap_s < _LONGEST_GAP_S:
            self._gap_s += (_GAP_WEIGHT if self._gap_s else 1.0) * (gap_s - self._gap_s)

    def _earn(self, now_s: float) -> None:
        if math.isinf(self._rate_hz):
            self._credit = _LEAST_BURST
        elif now_s > self._at_s:
            self._credit = min(self._most_credit, self._credit + self._rate_hz * (now_s - self._at_s))
        self._at_s = max(self._at_s, now_s)

    @property
    def _may_replace(self) -> bool:
        """Whether a newer sample takes the place of one that waits for credit."""
        return self._overflow is Overflow.LATEST and not math.isinf(self._rate_hz)

    @property
    def _is_outrun(self) -> bool:
        """Whether the source is faster than the rate in force, so that some of its samples must give way."""
        return self._may_replace and self._rate_hz * self._gap_s < 1.0

    @property
    def _waits_for_fresher(self) -> bool:
        return self._is_outrun and not self._is_due

    @property
    def _most_credit(self) -> float:
        if math.isinf(self._rate_hz):
            return _LEAST_BURST
        return max(_LEAST_BURST, _BURST_S * self._rate_hz)

    def _shed(self) -> None:
        bound = self._depth
        if self._may_replace:
            # Samples that are due wait only for the thread that writes them, as unpaced ones do: keep those.
            bound = max(1, int(self._credit)) if self._is_due else 1
        if (excess := self._withhold_oldest(bound)) > 0:
            # At full credit the next sample has been due for a whole period, so pacing does not hold it.
            is_held = self._rate_hz <= 0 or self._credit < self._most_credit or self._waits_for_fresher
            self._on_withheld(excess, self._limit if is_held else WithheldCause.BLOCKED)

    def _withhold_oldest(self, bound: int) -> int:
        """Keep the newest ones; return how many are withheld."""
        excess = max(0, len(self._queue) - bound)
        for _ in range(excess):
            self._queue.popleft()
        return excess
