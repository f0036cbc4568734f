"""Rate limits on messages from the network, and on lines in the log."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable

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
    """Limits every known source to its own rate, and all other sources together to one rate.

    So a sender with a thousand invented names takes nothing from the known sources.

    Parameters
    ----------
    rate_hz, burst : limit of every known source
    strangers_hz, strangers_burst : limit of all others together
    """

    def __init__(self, *, rate_hz: float, burst: float, strangers_hz: float, strangers_burst: float) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._known: dict[str, TokenBucket] = {}
        self._strangers = TokenBucket(strangers_hz, strangers_burst)

    def know(self, sources: Iterable[str]) -> None:
        """Replace the known sources; those that remain keep their spent budget."""
        self._known = {source: self._known.get(source) or TokenBucket(self._rate_hz, self._burst) for source in sources}

    def knows(self, source: str) -> bool:
        """Return whether a source is known."""
        return source in self._known

    def lets_pass(self, source: str, now_s: float) -> bool:
        """Return whether one more message of a source may pass now."""
        return self._known.get(source, self._strangers).take(now_s)


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
