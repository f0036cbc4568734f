"""Topics of the local domain that may cross the link, and their writers."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from arpd.relay.ends.offers import WriterOffer
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.ros.graph import Endpoint

_NAMELESS_S = 2.0  # a writer without a node for so long never has one
_REMEMBERED_S = 30.0  # a writer that left
_TOLD = ("node", "is_reliable", "is_latched", "deadline_ns", "lifespan_ns", "lease_ns", "is_manual")


class Surveyed:
    """One topic as it was read last: types and writers of other processes than this one.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.
    """

    def __init__(self) -> None:
        self.types: tuple[str, ...] = ()
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self.writers: tuple[WriterOffer, ...] = ()
        self.known: Mapping[bytes, WriterOffer] = {}  # by GUID, with those that left, whose samples may still come
        self._left_s: dict[bytes, float] = {}
        self.is_waiting = False  # whether the node of a writer may still become known
        self._unnamed_s: dict[bytes, float] = {}  # writers whose node is not known, and since when

    def read(self, writers: Collection[Endpoint], now_s: float) -> None:
        """Take the writers of the topic.

        Parameters
        ----------
        now_s : monotonic clock (s)
        """
        self._unnamed_s = {each.gid: self._unnamed_s.get(each.gid, now_s) for each in writers if not each.is_named}
        waiting = {gid for gid, since_s in self._unnamed_s.items() if now_s - since_s < _NAMELESS_S}
        self.is_waiting = bool(waiting)
        named = [each for each in writers if each.gid not in waiting]
        self.types = tuple(sorted({each.type_name for each in named}))
        if self.type_name not in self.types:  # a stray writer of another type must not stop what already flows
            self.type_name = self.types[0] if len(self.types) == 1 else ""
        offered = [each for each in named if each.type_name == self.type_name]
        hashes = {each.type_hash for each in offered} - {""}
        self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        present = {each.gid: _offer(each) for each in sorted(offered, key=lambda each: each.gid)}
        self._left_s = {gid: self._left_s.get(gid, now_s) for gid in self.known.keys() - present}
        left = {gid: self.known[gid] for gid, left_s in self._left_s.items() if now_s - left_s < _REMEMBERED_S}
        self.known = left | present
        self.writers = (*present.values(),)


class Survey:
    """Follows the graph: what is published here by others than this process.

    Parameters
    ----------
    node : the end's node in the local domain
    is_of_interest : returns whether to look at a topic, by its local name
    """

    def __init__(self, node: Node, *, is_of_interest: Callable[[str], bool]) -> None:
        self._view = GraphView.of(node)
        self._is_of_interest = is_of_interest
        self._lock = threading.Lock()
        self._changes = -1  # of the graph, when it was looked at last
        self.topics: Mapping[str, Surveyed] = {}

    def look(self) -> None:
        """Read what has changed."""
        before, self._changes = self._changes, self._view.look()
        found = sorted(topic for topic in self._view.types if self._is_of_interest(topic) and is_full_name(topic))
        topics = {topic: self.topics.get(topic) or Surveyed() for topic in found}
        new, self.topics = topics.keys() - self.topics.keys(), topics
        for topic, surveyed in topics.items():
            if before != self._changes or topic in new or surveyed.is_waiting:
                self._read(topic, surveyed)

    def writer(self, topic: str, gid: bytes) -> WriterOffer | None:
        """Return the writer with this GUID, after another look where it is not known; for any thread."""
        if (surveyed := self.topics.get(topic)) is None:
            return None
        if gid not in surveyed.known:
            self._view.look()
            self._read(topic, surveyed)
        return surveyed.known.get(gid)

    def _read(self, topic: str, surveyed: Surveyed) -> None:
        with self._lock:
            ours = self._view.ours
            others = [each for each in self._view.writers(topic) if each.participant not in ours]
            surveyed.read(others, time.monotonic())


def _offer(found: Endpoint) -> WriterOffer:
    return WriterOffer(gid=found.gid.hex(), **{name: getattr(found, name) for name in _TOLD})
