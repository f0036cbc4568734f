"""What is let in of what the network says: how often, how much of it, and a count of what was not."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.observation import MessageKind, MessageRefusal

_SAY_AGAIN_S = 60.0
_MOST_SAID = 32  # sources in that time: a source of invented names must not fill the log either


@dataclass(slots=True)
class TokenBucket:
    """Lets ``rate_hz`` through on average, and ``burst`` at once."""

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
    """Lets messages pass, each known source at a rate of its own, and all others together at one rate more.

    So whoever speaks under a thousand invented names takes nothing from those that are known.

    Parameters
    ----------
    rate_hz, burst : of every known source
    strangers_hz, strangers_burst : of all others together
    """

    def __init__(self, *, rate_hz: float, burst: float, strangers_hz: float, strangers_burst: float) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._known: dict[str, TokenBucket] = {}
        self._strangers = TokenBucket(strangers_hz, strangers_burst)

    def know(self, sources: Iterable[str]) -> None:
        """Take these for the known ones from now on."""
        self._known = {source: self._known.get(source) or TokenBucket(self._rate_hz, self._burst) for source in sources}

    def knows(self, source: str) -> bool:
        """Return whether a source is known."""
        return source in self._known

    def lets_pass(self, source: str, now_s: float) -> bool:
        """Return whether one more message of a source may pass now."""
        return self._known.get(source, self._strangers).take(now_s)


class RefusalCounts:
    """Counts what was refused, and tells which refusals are worth a line in the log."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[MessageKind, MessageRefusal]] = Counter()
        self._said_s: dict[tuple[MessageKind, MessageRefusal, str], float] = {}

    @property
    def counts(self) -> dict[tuple[MessageKind, MessageRefusal], int]:
        """Refusals so far."""
        return dict(self._counts)

    def note(self, kind: MessageKind, reason: MessageRefusal, source: str, now_s: float) -> bool:
        """Count one; return whether to say it: once a minute for each source and reason, and for so many sources."""
        self._counts[kind, reason] += 1
        return self._is_news((kind, reason, source), now_s)

    def _is_news(self, what: tuple[MessageKind, MessageRefusal, str], now_s: float) -> bool:
        if now_s - self._said_s.get(what, -math.inf) < _SAY_AGAIN_S:
            return False
        if what not in self._said_s and len(self._said_s) >= _MOST_SAID:
            self._said_s = {known: at_s for known, at_s in self._said_s.items() if now_s - at_s < _SAY_AGAIN_S}
            if len(self._said_s) >= _MOST_SAID:
                return False
        self._said_s[what] = now_s
        return True
