"""Topics of the local domain that may cross the link, and their writers."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, NamedTuple

from arpd.relay.ends.offers import WriterOffer
from arpd.relay.envelope import writer_key
from arpd.ros.graph_view import GraphView
from arpd.ros.names import is_full_name

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.ros.graph import Endpoint

_NAMELESS_S = 2.0  # a writer without a node for so long never has one
_TOLD = ("node", "is_reliable", "is_latched", "deadline_ns", "lifespan_ns", "lease_ns", "is_manual")
_REMEMBERED_S = 30.0  # a writer that left


class WriterClass(NamedTuple):
    """Writers that one reader hears."""

    is_reliable: bool
    is_latched: bool
    lease_ns: int  # of those that assert their liveliness by topic; 0 = the others

    @classmethod
    def of(cls, writer: WriterOffer) -> WriterClass:
        """Return the class of a writer."""
        return cls(writer.is_reliable, writer.is_latched, writer.lease_ns if writer.is_manual else 0)


class Writer(NamedTuple):
    """A writer of this side: what is offered of it, its class, and what stands for it in samples."""

    offer: WriterOffer
    kind: WriterClass
    key: bytes


class Surveyed:
    """One topic as it was read last: types and writers of other processes than this one.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.
    """

    def __init__(self) -> None:
        self.types: tuple[str, ...] = ()
        self.writers: Mapping[str, WriterOffer] = {}  # by GUID in hexadecimal digits
        self.known: Mapping[bytes, Writer] = {}  # by GUID, with those that left lately, whose samples may still come
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self._seen_s: dict[bytes, float] = {}
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
        self._offer([each for each in named if each.type_name == self.type_name], now_s)

    def _offer(self, offered: Iterable[Endpoint], now_s: float) -> None:
        hashes = {each.type_hash for each in offered} - {""}
        self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        present = {each.gid: _writer(each) for each in offered}
        here = [*map(bytes.fromhex, self.writers), *present]  # those that left were here until now
        self._seen_s = {gid: s for gid, s in self._seen_s.items() if now_s - s < _REMEMBERED_S} | dict.fromkeys(
            here, now_s
        )
        self.known = {gid: writer for gid, writer in self.known.items() if gid in self._seen_s} | present
        self.writers = {writer.offer.gid: writer.offer for writer in present.values()}


class Survey:
    """Follows the graph: what is published here by others than this process.

    Parameters
    ----------
    node : the end's node in the local domain
    is_of_interest : returns whether to look at a topic, by its local name
    """

    def __init__(
        self, node: Node, *, is_of_interest: Callable[[str], bool], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._view = GraphView.of(node)
        self._is_of_interest = is_of_interest
        self._clock = clock
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

    def writer(self, topic: str, gid: bytes) -> Writer | None:
        """Return the writer with this GUID, after another look where it is not known; for any thread."""
        if (surveyed := self.topics.get(topic)) is None:
            return None
        if gid not in surveyed.known:
            self._view.look()
            self._read(topic, surveyed)
        return surveyed.known.get(gid)

    def gids(self, topic: str) -> Collection[str]:
        """Return the GUIDs of the topic's writers, without those of this process."""
        surveyed = self.topics.get(topic)
        return surveyed.writers.keys() if surveyed is not None else ()

    def _read(self, topic: str, surveyed: Surveyed) -> None:
        with self._lock:
            ours = self._view.ours
            surveyed.read(
                [writer for writer in self._view.writers(topic) if writer.participant not in ours], self._clock()
            )


def _writer(found: Endpoint) -> Writer:
    offer = WriterOffer(gid=found.gid.hex(), **{name: getattr(found, name) for name in _TOLD})
    return Writer(offer, WriterClass.of(offer), writer_key(offer.gid))
