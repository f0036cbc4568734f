"""Rate limits on messages from the network, and on lines in the log."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable


_MOST_SOURCES = 1000  # as many nodes as any robot has
_SILENT_S = 10.0  # then a source gives up its place
_LOG_AGAIN_S = 60.0
_MOST_LOGGED = 32  # things in that time: invented names must not fill the log


@dataclass(slots=True)
class TokenBucket:
    """Lets ``rate_hz`` through on average and ``burst`` at once; ``asked_s`` is when somebody asked last (s)."""

    rate_hz: float
    burst: float
    asked_s: float = 0.0
    _spent: float = 0.0

    def take(self, now_s: float) -> bool:
        """Return whether one more may pass now."""
        self._spent = max(0.0, self._spent - self.rate_hz * max(0.0, now_s - self.asked_s))
        self.asked_s = now_s
        if self._spent + 1.0 > self.burst:
            return False
        self._spent += 1.0
        return True


class SourceRateLimiter:
    """Limits every source to its own rate, so a sender that floods takes nothing from the others.

    Sources are bounded: while more send, those that come late share one rate.

    Parameters
    ----------
    rate_hz, burst : limit of each
    """

    def __init__(self, *, rate_hz: float, burst: float) -> None:
        self._limit = rate_hz, burst
        self._buckets: dict[Hashable, TokenBucket] = {}
        self._late = TokenBucket(*self._limit)

    def lets_pass(self, source: Hashable, now_s: float) -> bool:
        """Return whether one more message of a source may pass now."""
        bucket = self._buckets.get(source)
        return (self._bucket_for(source, now_s) if bucket is None else bucket).take(now_s)

    def _bucket_for(self, source: Hashable, now_s: float) -> TokenBucket:
        if len(self._buckets) >= _MOST_SOURCES:
            self._buckets = {each: had for each, had in self._buckets.items() if now_s - had.asked_s < _SILENT_S}
            if len(self._buckets) >= _MOST_SOURCES:
                return self._late
        self._buckets[source] = TokenBucket(*self._limit, asked_s=now_s)
        return self._buckets[source]


class OncePerMinute:
    """Picks what is worth a line in the log: each thing once a minute, and at most 32 things in that time."""

    def __init__(self) -> None:
        self._logged_s: dict[Hashable, float] = {}

    def take(self, what: Hashable, now_s: float) -> bool:
        """Return whether to log this now."""
        if now_s - self._logged_s.get(what, -math.inf) < _LOG_AGAIN_S:
            return False
        if what not in self._logged_s and len(self._logged_s) >= _MOST_LOGGED:
            self._logged_s = {known: at_s for known, at_s in self._logged_s.items() if now_s - at_s < _LOG_AGAIN_S}
            if len(self._logged_s) >= _MOST_LOGGED:
                return False
        self._logged_s[what] = now_s
        return True
