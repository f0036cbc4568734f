"""The other end of the relay, as this one hears it: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.relay.ends.offers import EndState

EVERY_S = 1.0  # each end says that often that it lives
REPLACED_S = 1.5  # one sign of life missed, and another process speaks for the end
_SILENT_S = 3.5  # three of them missed
_GONE_S = 30.0  # an outage of a Wi-Fi link mostly takes less
_DEAF_S = 20.0  # an end that is heard hears in turn within the 9 s of an announcement


class Partner:
    """Follows the states and the signs of life of the other end, and its restarts.

    A killed end returns as a new session. Two ends that run at the same time are two sessions that both speak: the
    first one stays in force, the other one is named. None follows an end that follows another host's: of two robots in
    one link domain, the second would obey what is meant for the first, and a second base computer would be sent all
    topics, while nobody hears its commands. So an end that restarts waits until the other one has missed its
    predecessor; a second one on a host, while the first one lives, follows nobody, and doubles nothing.

    Parameters
    ----------
    own : how the GUIDs of this end begin, in hexadecimal digits
    """

    def __init__(self, *, own: str) -> None:
        self._own = own
        self._states: dict[int, EndState] = {}  # newest of each session
        self._heard_s: dict[int, float] = {}  # last sign of life of each
        self._session = 0  # in force
        self._listener = 0  # the last session that followed this end
        self._unheard_s = math.inf  # since when it speaks, and follows nobody

    def tell(self, state: EndState, now_s: float) -> None:
        """Take a state, which is a sign of life, too."""
        self._states[state.session] = state
        self._heard_s[state.session] = now_s

    def hear(self, session: int, now_s: float) -> None:
        """Take a sign of life; one before the first state says nothing."""
        if session in self._states:
            self._heard_s[session] = now_s

    def look(self, now_s: float) -> EndState | None:
        """Choose the session in force; return its newest state, None while it is gone.

        It may return, and says nothing new then, so its state is kept.
        """
        for session in [
            each for each in self._states if each != self._session and not self._is_heard(each, now_s, _GONE_S)
        ]:
            del self._states[session], self._heard_s[session]
        speaking = [each for each in self._states if self._spoke(each, now_s, REPLACED_S)]
        if speaking and self._session not in speaking:
            self._session = max(speaking, key=lambda each: self._heard_s[each])
        state = self._states.get(self._session) if self.is_there(now_s) else None
        if state is not None and state.follows == self._own:
            self._listener = state.session
        has_lost_us = state is not None and not state.follows and state.session == self._listener
        is_unheard = has_lost_us and self.is_reachable(now_s)
        self._unheard_s = min(self._unheard_s, now_s) if is_unheard else math.inf
        return state

    def is_deaf(self, now_s: float) -> bool:
        """Return whether the session in force, which has followed this end, speaks and for 20 s has followed nobody.

        After an outage in which all leases ended, Fast DDS 2.14 may never tell others again which writers this end has.
        """
        return now_s - self._unheard_s > _DEAF_S

    def is_there(self, now_s: float) -> bool:
        """Return whether the session in force spoke within the time of an outage that is bridged."""
        return self._spoke(self._session, now_s, _GONE_S)

    def is_reachable(self, now_s: float) -> bool:
        """Return whether the session in force spoke lately."""
        return self._spoke(self._session, now_s, _SILENT_S)

    def others(self, now_s: float) -> list[str]:
        """Name the hosts of other sessions that speak beside the one in force."""
        return self._hosts(now_s, lambda state: state.session != self._session)

    def elsewhere(self, now_s: float) -> list[str]:
        """Name the hosts of sessions that speak and follow another end than this one."""
        return self._hosts(now_s, lambda state: not self._is_free(state))

    def _hosts(self, now_s: float, is_meant: Callable[[EndState], bool]) -> list[str]:
        speaking = (state for session, state in self._states.items() if self._is_heard(session, now_s, REPLACED_S))
        return sorted(state.host for state in speaking if is_meant(state))

    def _is_free(self, state: EndState) -> bool:
        return state.follows in {"", self._own}

    def _is_heard(self, session: int, now_s: float, within_s: float) -> bool:
        return now_s - self._heard_s.get(session, -math.inf) <= within_s

    def _spoke(self, session: int, now_s: float, within_s: float) -> bool:
        """Return whether it spoke lately, and may be followed."""
        return self._is_heard(session, now_s, within_s) and self._is_free(self._states[session])
