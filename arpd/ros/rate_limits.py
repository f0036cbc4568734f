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
    """Lets ``rate_hz`` through on average and ``burst`` at once."""

    rate_hz: float
    burst: float
    _spent: float = 0.0
    _at_s: float = 0.0

    def take(self, now_s: float) -> bool:
        """Return whether one more may pass now."""
        self._spent = max(0.0, self._spent - self.rate_hz * max(0.0, now_s - self._at_s))
        self._at_s = now_s
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
        self._rate_hz, self._burst = rate_hz, burst
        self._heard: dict[Hashable, tuple[TokenBucket, float]] = {}  # with the time of the last message (s)
        self._late = TokenBucket(rate_hz, burst)

    def lets_pass(self, source: Hashable, now_s: float) -> bool:
        """Return whether one more message of a source may pass now."""
        if source not in self._heard and len(self._heard) >= _MOST_SOURCES:
            self._heard = {known: heard for known, heard in self._heard.items() if now_s - heard[1] < _SILENT_S}
            if len(self._heard) >= _MOST_SOURCES:
                return self._late.take(now_s)
        bucket, _ = self._heard.get(source) or (TokenBucket(self._rate_hz, self._burst), now_s)
        self._heard[source] = bucket, now_s
        return bucket.take(now_s)


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
