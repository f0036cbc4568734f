"""Registry of publishers, or of readers: those that announce themselves and that the graph shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from arpd.model.endpoints import PublisherState, ReaderState

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

MOST_OF_NODE = 256  # endpoints that one node may announce: more than any relay carries
MOST = 2000  # of all nodes together: more than any robot has
_FLOODED_S = 10.0  # silence that proves nothing while a flood displaces announcements
_UNSEEN_S = 10.0  # the graph may lose an endpoint for some seconds, most of all behind a bad link

S = TypeVar("S", PublisherState, ReaderState)


@dataclass(slots=True)
class _Endpoint(Generic[S]):
    state: S
    at_s: float
    is_shown: bool = False  # by the graph at the last look
    shown_s: float | None = None  # last time that the graph showed it


class Endpoints(Generic[S]):
    """Last announcement of every endpoint, by node and topic.

    An endpoint counts once the graph has shown it, so an invented one never counts. Entries are bounded per node and in
    all. A known endpoint keeps its entry; a new one that the graph shows may replace one it never showed.

    Parameters
    ----------
    stale_s : silence after which an endpoint is gone (s)
    """

    def __init__(self, stale_s: float) -> None:
        self._stale_s = stale_s
        self._known: dict[tuple[str, str], _Endpoint[S]] = {}
        self._of_node: dict[str, int] = {}
        self._is_shown: Callable[[str, str], bool] = lambda _node, _topic: False

    @property
    def pending(self) -> int:
        """Number of endpoints that the graph has not shown."""
        return sum(endpoint.shown_s is None for endpoint in self._known.values())

    @property
    def topics(self) -> frozenset[str]:
        """Topics of all endpoints."""
        return frozenset(topic for _, topic in self._known)

    def note(self, state: S, now_s: float) -> bool:
        """Note an announcement; return False when there is no room for it."""
        key = state.node, state.topic
        if (known := self._known.get(key)) is not None:
            known.state, known.at_s = state, now_s
            return True
        is_shown = self._is_shown(*key)
        if self._of_node.get(state.node, 0) >= MOST_OF_NODE or not self._has_room(is_shown):
            return False
        self._known[key] = _Endpoint(state, now_s, is_shown, now_s if is_shown else None)
        self._of_node[state.node] = self._of_node.get(state.node, 0) + 1
        return True

    def see(self, is_shown: Callable[[str, str], bool], now_s: float) -> None:
        """Note what the graph shows now, as a function of node and topic."""
        self._is_shown = is_shown
        for (node, topic), endpoint in self._known.items():
            was_shown, endpoint.is_shown = endpoint.is_shown, is_shown(node, topic)
            if was_shown or endpoint.is_shown:
                endpoint.shown_s = now_s

    def live(
        self, now_s: float, *, is_flooded: bool = False, known_of: Callable[[S], Mapping[str, Any]] = lambda _state: {}
    ) -> list[S]:
        """Return the endpoints that announced themselves lately, with the age of that, sorted by node and topic.

        Parameters
        ----------
        is_flooded : True when a flood may have displaced announcements; known endpoints are then kept for longer
        known_of : further fields of a state; applied here because one copy of each state per tick is enough
        """
        kept_s = max(self._stale_s, _FLOODED_S) if is_flooded else self._stale_s
        for key, endpoint in list(self._known.items()):
            if now_s - endpoint.at_s > (kept_s if endpoint.is_shown else self._stale_s):
                self._forget(key)
        return [
            replace(endpoint.state, age_s=now_s - endpoint.at_s, **known_of(endpoint.state))
            for _, endpoint in sorted(self._known.items())
            if endpoint.is_shown or (endpoint.shown_s is not None and now_s - endpoint.shown_s <= _UNSEEN_S)
        ]

    def _has_room(self, is_shown: bool) -> bool:  # noqa: FBT001 - a condition, not a mode
        if len(self._known) < MOST:
            return True
        unseen = next((key for key, endpoint in self._known.items() if endpoint.shown_s is None), None)
        if not is_shown or unseen is None:
            return False
        self._forget(unseen)
        return True

    def _forget(self, key: tuple[str, str]) -> None:
        del self._known[key]
        self._of_node[key[0]] -= 1
        if not self._of_node[key[0]]:
            del self._of_node[key[0]]
