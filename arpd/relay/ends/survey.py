"""Topics of the local domain that may cross the link, and their writers."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from arpd.relay.offers import WriterOffer
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.ros.graph import Endpoint

_NAMELESS_S = 2.0  # a writer without a node for so long never has one
_MOST_WRITERS = 2**16  # of one topic: their numbers have 16 bits
_REMEMBERED_S = 30.0  # a writer that left; its number is free again then


class Surveyed:
    """One topic as it was read last: types and writers of other processes than this one.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.
    """

    def __init__(self) -> None:
        self.types: tuple[str, ...] = ()
        self.writers: Mapping[str, WriterOffer] = {}  # by GUID
        self.known: Mapping[str, WriterOffer] = {}  # with those that left lately, whose samples may still come
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self._seen_s: dict[str, float] = {}
        self.is_waiting = False  # whether the node of a writer may still become known
        self._unnamed_s: dict[str, float] = {}  # writers whose node is not known, and since when

    def read(self, writers: Iterable[Endpoint], now_s: float) -> None:
        """Take the writers of the topic.

        Parameters
        ----------
        now_s : monotonic clock (s)
        """
        by_gid = {writer.gid.hex(): writer for writer in writers}
        unnamed = [gid for gid, writer in by_gid.items() if not writer.is_named]
        self._unnamed_s = {gid: self._unnamed_s.get(gid, now_s) for gid in unnamed}
        waiting = {gid for gid, since_s in self._unnamed_s.items() if now_s - since_s < _NAMELESS_S}
        self.is_waiting = bool(waiting)
        self._offer({gid: writer for gid, writer in by_gid.items() if gid not in waiting}, now_s)

    def _offer(self, named: Mapping[str, Endpoint], now_s: float) -> None:
        self.types = tuple(sorted({writer.type_name for writer in named.values()}))
        if self.type_name not in self.types:  # a stray writer of another type must not stop what already flows
            self.type_name = self.types[0] if len(self.types) == 1 else ""
        offered = {gid: writer for gid, writer in named.items() if writer.type_name == self.type_name}
        hashes = {writer.type_hash for writer in offered.values()} - {""}
        self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        self._seen_s.update(dict.fromkeys([*self.writers, *offered], now_s))  # those that left were here until now
        self._seen_s = {gid: at_s for gid, at_s in self._seen_s.items() if now_s - at_s < _REMEMBERED_S}
        known = {gid: writer for gid, writer in self.known.items() if gid in self._seen_s}
        taken = {writer.number for writer in known.values()}
        free = (number for number in range(_MOST_WRITERS) if number not in taken)
        for gid, writer in offered.items():
            number = known[gid].number if gid in known else next(free, None)
            if number is not None:
                known[gid] = _offer(writer, gid, number)
        self.known = known
        self.writers = {gid: known[gid] for gid in offered if gid in known}


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

    def read(self, topic: str) -> Surveyed | None:
        """Read the writers of one topic now; for any thread."""
        surveyed = self.topics.get(topic)
        if surveyed is not None:
            self._view.look()
            self._read(topic, surveyed)
        return surveyed

    def gids(self, topic: str) -> Collection[str]:
        """Return the GUIDs of the topic's writers, without those of this process."""
        surveyed = self.topics.get(topic)
        return surveyed.writers.keys() if surveyed is not None else ()

    def _read(self, topic: str, surveyed: Surveyed) -> None:
        with self._lock:
            ours = self._view.ours
            others = [writer for writer in self._view.writers(topic) if writer.participant not in ours]
            surveyed.read(others, time.monotonic())


def _offer(writer: Endpoint, gid: str, number: int) -> WriterOffer:
    return WriterOffer(
        number=number,
        node=writer.node,
        gid=gid,
        is_reliable=writer.is_reliable,
        is_latched=writer.is_latched,
        deadline_ns=writer.deadline_ns,
        lifespan_ns=writer.lifespan_ns,
        lease_ns=writer.lease_ns,
        is_manual=writer.is_manual,
    )
