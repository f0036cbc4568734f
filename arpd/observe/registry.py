"""Registry of publishers: those that announce themselves and that the graph shows."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from arpd.model.endpoints import PublisherState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

MOST_OF_NODE = 256  # endpoints that one node may announce: more than any relay carries
MOST = 2000  # of all nodes together: more than any robot has
_FLOODED_S = 10.0  # silence that proves nothing while a flood displaces announcements
_UNSEEN_S = 10.0  # the graph may lose an endpoint for some seconds, most of all behind a bad link

_FIELDS = tuple(each.name for each in fields(PublisherState))
_Identity = tuple[str, str]  # node and topic


SERIALS = 256  # of statuses; the next one is 0 again


class Tag(NamedTuple):
    """Name of a status, for the messages of numbers that follow it.

    Parameters
    ----------
    incarnation : random number of the node's life: a node that returns is another one
    number : of the endpoint, never given twice in that life
    serial : counts the endpoint's statuses
    """

    incarnation: int
    number: int
    serial: int

    def is_before(self, other: Tag) -> bool:
        """Return whether this is an earlier status of the same endpoint, by serials that wrap."""
        is_same = self[:2] == other[:2]
        return is_same and 0 < (other.serial - self.serial) % SERIALS < SERIALS // 2


class Row(Protocol):
    """What one endpoint told since its last status."""

    @property
    def number(self) -> int:
        """Number of the endpoint."""

    @property
    def serial(self) -> int:
        """Serial of that status."""

    def changes(self, told: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the fields that changed since, from the fields of that status."""


@dataclass(slots=True)
class _Endpoint:
    told: Mapping[str, Any]  # fields of the last status
    now: Mapping[str, Any]  # the same, with what changed since
    at_s: float
    tag: Tag | None = None
    known: Mapping[str, Any] | None = None  # fields that the graph shows
    state: PublisherState | None = None  # made of all this when somebody asks
    is_shown: bool = False  # by the graph at the last look
    shown_s: float = -math.inf  # last time that the graph showed it


class Endpoints:
    """Last announcement of every endpoint, by node and topic.

    An endpoint counts once the graph has shown it, so an invented one never counts. Entries are bounded per node and in
    all. A known endpoint keeps its entry; a new one that the graph shows may replace one it never showed.

    Parameters
    ----------
    stale_s : silence after which an endpoint is gone (s)
    """

    def __init__(self, stale_s: float) -> None:
        self._stale_s = stale_s
        self._known: dict[_Identity, _Endpoint] = {}
        self._by_number: dict[tuple[str, int, int], _Identity] = {}  # node, incarnation and number
        self._of_node: dict[str, int] = {}
        self._unseen: dict[_Identity, None] = {}  # that the graph never showed, oldest first
        self._is_shown: Callable[[str, str], bool] = lambda _node, _topic: False
        self._live: tuple[PublisherState, ...] | None = None  # None when something changed since
        self._live_until_s = -math.inf  # until then time alone changes nothing
        self._known_of: Any = None
        self._order: list[_Identity] | None = None  # None when endpoints came or went since

    @property
    def pending(self) -> int:
        """Number of endpoints that the graph has not shown."""
        return len(self._unseen)

    @property
    def topics(self) -> frozenset[str]:
        """Topics of all endpoints."""
        return frozenset(topic for _, topic in self._known)

    def note(self, state: PublisherState, now_s: float, tag: Tag | None = None) -> bool:
        """Note an announcement; return False when there is no room for it."""
        key = state.node, state.topic
        told = {name: getattr(state, name) for name in _FIELDS}
        self._live = None
        if (known := self._known.get(key)) is not None:
            if tag is not None and known.tag is not None and tag.is_before(known.tag):
                return True  # it waited for the graph while a newer one came
            self._name(key, known, tag)
            known.told = known.now = told
            known.at_s, known.state = now_s, None
            return True
        is_shown = self._is_shown(*key)
        if self._of_node.get(state.node, 0) >= MOST_OF_NODE or not self._has_room(is_shown):
            return False
        endpoint = self._known[key] = _Endpoint(told, told, now_s)
        endpoint.is_shown, endpoint.shown_s = is_shown, now_s if is_shown else -math.inf
        self._live_until_s = min(self._live_until_s, now_s + self._stale_s)
        if not is_shown:
            self._unseen[key] = None
        self._order = None
        self._name(key, endpoint, tag)
        self._of_node[state.node] = self._of_node.get(state.node, 0) + 1
        return True

    def note_rows(
        self, node: str, incarnation: int, rows: Iterable[Row], *, common: Mapping[str, Any], now_s: float
    ) -> None:
        """Note what the endpoints of a node told since their statuses; those whose status is missing are left out.

        Parameters
        ----------
        common : fields that all of them have in common
        """
        for row in rows:
            key = self._by_number.get((node, incarnation, row.number))
            if key is None:
                continue
            endpoint = self._known[key]
            endpoint.at_s, endpoint.state = now_s, None
            if endpoint.tag is not None and endpoint.tag.serial == row.serial:
                endpoint.now = {**endpoint.told, **common, **row.changes(endpoint.told)}
            else:  # a status was lost; a sign of life all the same
                endpoint.now = {**endpoint.now, **common}
        self._live = None

    def renew(self, keys: Iterable[_Identity], now_s: float) -> bool:
        """Note that endpoints repeat their announcement; return False if not all of them are known."""
        found = [self._known.get(key) for key in keys]
        for endpoint in found:
            if endpoint is not None:
                endpoint.at_s, endpoint.state = now_s, None
        self._live = None
        return None not in found

    def see(self, is_shown: Callable[[str, str], bool], now_s: float) -> None:
        """Note what the graph shows now, as a function of node and topic."""
        self._is_shown = is_shown
        for key, endpoint in self._known.items():
            was_shown, endpoint.is_shown = endpoint.is_shown, is_shown(*key)
            if was_shown or endpoint.is_shown:
                endpoint.shown_s = now_s
            if was_shown != endpoint.is_shown:
                self._unseen.pop(key, None)
                self._live = None

    def live(
        self,
        now_s: float,
        *,
        is_flooded: bool = False,
        known_of: Callable[[str, str], Mapping[str, Any]] = lambda _node, _topic: {},
    ) -> tuple[PublisherState, ...]:
        """Return the endpoints that announced themselves lately, sorted by node and topic.

        It is the same tuple until something arrives, expires, or the graph changes.

        Parameters
        ----------
        is_flooded : True when a flood may have displaced announcements; known endpoints are then kept for longer
        known_of : returns further fields of a node's endpoint on a topic; another function may return others
        """
        if self._live is not None and known_of is self._known_of and now_s <= self._live_until_s:
            return self._live
        if now_s > self._live_until_s:
            self._expire(now_s, max(self._stale_s, _FLOODED_S) if is_flooded else self._stale_s)
        if known_of is not self._known_of:
            self._known_of = known_of
            self._join()
        if self._order is None:
            self._order = sorted(self._known)
        # A silence or an absence that began later ends later, so this is never too late.
        oldest_s = min((endpoint.at_s for endpoint in self._known.values()), default=math.inf)
        self._live_until_s = oldest_s + self._stale_s
        found = []
        for key in self._order:
            endpoint = self._known[key]
            if endpoint.is_shown:
                found.append(endpoint.state or self._state_of(key, endpoint))
            elif now_s <= endpoint.shown_s + _UNSEEN_S:
                found.append(endpoint.state or self._state_of(key, endpoint))
                self._live_until_s = min(self._live_until_s, endpoint.shown_s + _UNSEEN_S)
        self._live = tuple(found)
        return self._live

    def _expire(self, now_s: float, kept_s: float) -> None:
        """Forget those that are silent for too long, for ``kept_s`` if the graph shows them (s)."""
        for key, endpoint in list(self._known.items()):
            if now_s - endpoint.at_s > (kept_s if endpoint.is_shown else self._stale_s):
                self._forget(key)

    def _join(self) -> None:
        """Note what the graph now shows of every endpoint, and forget the states that it changes."""
        for key, endpoint in self._known.items():
            if (known := self._known_of(*key)) != endpoint.known:
                endpoint.known, endpoint.state = known, None

    def _state_of(self, key: _Identity, endpoint: _Endpoint) -> PublisherState:
        if endpoint.known is None:
            endpoint.known = self._known_of(*key)
        # 4 µs; `dataclasses.replace` takes twice that.
        state = PublisherState(**{**endpoint.now, "announced_at_s": endpoint.at_s, **endpoint.known})
        endpoint.state = state
        return state

    def _name(self, key: _Identity, endpoint: _Endpoint, tag: Tag | None) -> None:
        """Give an endpoint the tag of its newest status."""
        node, _ = key
        if endpoint.tag is not None:
            old = node, endpoint.tag.incarnation, endpoint.tag.number
            if self._by_number.get(old) == key:
                del self._by_number[old]
        if tag is not None:
            self._by_number[node, tag.incarnation, tag.number] = key
        endpoint.tag = tag

    def _has_room(self, is_shown: bool) -> bool:  # noqa: FBT001 - a condition, not a mode
        if len(self._known) < MOST:
            return True
        unseen = next(iter(self._unseen), None)
        if not is_shown or unseen is None:
            return False
        self._forget(unseen)
        return True

    def _forget(self, key: _Identity) -> None:
        self._name(key, self._known[key], None)
        del self._known[key]
        self._unseen.pop(key, None)
        self._order = None
        self._of_node[key[0]] -= 1
        if not self._of_node[key[0]]:
            del self._of_node[key[0]]
