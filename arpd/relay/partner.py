"""The other end of the relay, as this one hears it: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.relay.ends.offers import EndState

EVERY_S = 1.0  # each end says that often that it lives
REPLACED_S = 1.5  # one sign of life missed, and another process speaks for the end
_SILENT_S = 3.5  # three of them missed
_GONE_S = 30.0  # an outage of a Wi-Fi link mostly takes less


class Partner:
    """Follows the states and the signs of life of the other end, and its restarts.

    A killed end returns as a new session. Two ends that run at the same time are two sessions that both speak: the
    first one stays in force, the other one is named.
    """

    def __init__(self) -> None:
        self._heard_s: dict[int, float] = {}  # last sign of life by session
        self._states: dict[int, EndState] = {}
        self._session = 0
        self._is_gone = False

    @property
    def state(self) -> EndState | None:
        """Newest state of the session in force, None while it is gone; it may return, and says nothing new then."""
        return None if self._is_gone else self._states.get(self._session)

    def hear(self, session: int, now_s: float, state: EndState | None = None) -> None:
        """Take a sign of life, with or without a state."""
        self._heard_s[session] = now_s
        known = self._states.get(session)
        if state is not None and (known is None or state.serial > known.serial):
            self._states[session] = state

    def look(self, now_s: float) -> None:
        """Choose the session in force."""
        for session in [each for each, heard_s in self._heard_s.items() if now_s - heard_s > _GONE_S]:
            if session != self._session:
                del self._heard_s[session]
                self._states.pop(session, None)
        if now_s - self._heard_s.get(self._session, -math.inf) <= REPLACED_S and self._session in self._states:
            self._is_gone = False
            return
        heard = [each for each in self._states if now_s - self._heard_s[each] <= REPLACED_S]
        if heard or self._session not in self._states:
            self._session = max(heard, key=lambda each: self._heard_s[each], default=self._session)
        self._is_gone = now_s - self._heard_s.get(self._session, -math.inf) > _GONE_S

    def is_reachable(self, now_s: float) -> bool:
        """Return whether the session in force spoke lately."""
        return self.state is not None and now_s - self._heard_s[self._session] <= _SILENT_S

    def others(self, now_s: float) -> list[str]:
        """Name the hosts of other sessions that speak beside the one in force."""
        return sorted(
            state.host
            for session, state in self._states.items()
            if session != self._session and now_s - self._heard_s[session] <= REPLACED_S
        )
