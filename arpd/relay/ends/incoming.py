"""Topics that the other side offers: their ghosts, who reads them here, and their samples from the link."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from rclpy.exceptions import NameValidationException

from arpd.model.endpoints import WriterQos
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.depths import BULK_BYTES, held_depth
from arpd.relay.ends.ghosts import GhostNodes, GhostWriter
from arpd.relay.ends.link_reader import LinkReader
from arpd.relay.ends.types import UnknownTypeError, definition_hash, expected_bytes, message_class
from arpd.relay.envelope import Chunk, Record, key_of, split, unpack

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.relay.ends.link_thread import LinkThread
    from arpd.relay.offers import TopicOffer
    from arpd.relay.selection import Side
    from arpd.ros.raw_reader import ReadingThread

_OWNER = "topics"  # of ghost nodes
_LINGER_S = 5.0  # a topic that nobody reads any more crosses that long: a reader may just be restarting
# Samples of a writer that is gone may still be on their way, and an end that restarts knows no writer at first.
_GRACE_S = 5.0
_MOST_HELD = 1000
_HELD_S = 3.0
_OLD_S = 0.5  # on its way beyond the usual: an outage lay between
_NEWER_S = 0.3  # what an outage delayed comes within that; the newest sample of each source is delivered
_HASH = 15  # characters that tell two hashes apart
_MOST_SWAPS = 5  # asked for in a step: each takes a millisecond under the lock, and is announced to every process


class _Held(NamedTuple):
    session: int
    record: Record
    at_s: float


class _Topic:
    """One topic that the other side offers."""

    def __init__(self, name: str, offer: TopicOffer) -> None:
        self.name = name
        self.offer = offer
        self.ghosts: dict[str, GhostWriter] = {}  # by the GUID of the original
        self.by_number: dict[int, GhostWriter] = {}  # by its number in the session in force
        self.gone_s: dict[str, float] = {}  # when an original was missed first
        self.held: deque[_Held] = deque(maxlen=_MOST_HELD)  # samples of writers that no state has named yet
        self.old: dict[int, tuple[Record, float]] = {}  # by writer: an old sample, and until when a newer one may come
        self.read_s = float("-inf")  # when somebody read it last


class Incoming:
    """Keeps a ghost of every offered writer, wants the topics that have readers, and writes what arrives.

    Parameters
    ----------
    link_node : the end's node in the domain of the link
    nodes : ghosts of the other side's nodes
    thread : takes the samples
    link : accounts for the chunks
    side : names on this side
    depths : least KEEP_LAST depth of ghosts, by topic
    """

    def __init__(
        self,
        *,
        link_node: Node,
        nodes: GhostNodes,
        thread: ReadingThread,
        link: LinkThread,
        side: Side,
        depths: Mapping[str, int],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link_node = link_node
        self._nodes = nodes
        self._thread = thread
        self._link = link
        self._side = side
        self._depths = depths
        self._clock = clock
        self._lock = threading.Lock()  # guards the topics: samples come in the reading thread
        self._session = 0
        self._topics: dict[str, _Topic] = {}
        self._members: dict[tuple[str, int], _Topic] = {}
        self._by_key: dict[bytes, str] = {}  # names on the link, by what stands for them
        self._readers: dict[str, LinkReader] = {}  # by the name on the link
        self.refused: dict[str, str] = {}
        self.wants: frozenset[str] = frozenset()
        self.received = 0
        self.doubled = 0
        self.unknown = 0
        self.outdated = 0

    def follow(self, offers: Mapping[str, TopicOffer], *, session: int, refused: Collection[str] = frozenset()) -> None:
        """Make the ghosts of what is offered now, and remove those of what no longer is.

        Parameters
        ----------
        offers : topics of the other side that enter here
        session : of the other end, 32 bit
        refused : topics that do not enter; their ghosts go at once, because a reader would hear samples twice
        """
        now_s = self._clock()
        with self._lock:
            self._session = session
            self.refused = {}
            for name in self._topics.keys() & set(refused):
                self._drop(self._topics[name])
            for name, offer in offers.items():
                try:
                    self._follow(name, offer)
                except (UnknownTypeError, NameValidationException, RuntimeError, ValueError) as fault:
                    self.refused[name] = str(fault)
            self._by_key = {key_of(topic.offer.link_name): topic.offer.link_name for topic in self._topics.values()}
            self._members = {(topic.offer.link_name, topic.offer.member): topic for topic in self._topics.values()}
            for name, topic in list(self._topics.items()):
                present = {writer.gid for writer in offers[name].writers} if name in offers else set()
                self._retire(topic, present, now_s)
                self._write_held(topic, now_s)

    def step(self, *, is_reachable: bool) -> None:
        """Look for readers, and open or close what they need."""
        now_s = self._clock()
        wants, links = set(), set()
        with self._lock:
            for topic in list(self._topics.values()):
                for ghost in topic.ghosts.values():
                    ghost.step(is_reachable=is_reachable)
                if any(ghost.matched() for ghost in topic.ghosts.values()):
                    topic.read_s = now_s
                if now_s - topic.read_s < _LINGER_S:
                    wants.add(topic.name)
                    links.add(topic.offer.link_name)
                for writer, (record, until_s) in list(topic.old.items()):
                    if now_s >= until_s:
                        self._write(topic, record)
                        topic.old.pop(writer, None)
                if topic.gone_s:
                    self._retire(topic, topic.ghosts.keys() - topic.gone_s.keys(), now_s)
            ghosts = [ghost for topic in self._topics.values() for ghost in topic.ghosts.values()]
            swap_some(ghosts, now_s)
            writers = [ghost.offer for ghost in ghosts]
        self._nodes.keep(_OWNER, {self._side.local_name(writer.node) for writer in writers})
        for name in links - self._readers.keys():
            self._readers[name] = self._reader(name)
        for name in self._readers.keys() - links:
            self._readers.pop(name).destroy()
        self.wants = frozenset(wants)

    def deliver_together(self, message: bytes, chunk: Chunk, age_s: float) -> None:
        """Write small samples of several topics that left together; ValueError = they are none."""
        for key, found in [(key, unpack(part)) for key, part in split(message)]:
            self._take(self._by_key.get(key, ""), found, chunk, age_s)

    def close(self) -> None:
        """Destroy everything."""
        for reader in self._readers.values():
            reader.destroy()
        with self._lock:
            for topic in self._topics.values():
                for ghost in topic.ghosts.values():
                    ghost.destroy()

    def _reader(self, link_name: str) -> LinkReader:
        def deliver(message: bytes, chunk: Chunk, age_s: float) -> None:
            self._take(link_name, unpack(message), chunk, age_s)

        return LinkReader(self._link_node, link_name, link=self._link, thread=self._thread, deliver=deliver)

    def _take(self, link_name: str, records: list[Record], chunk: Chunk, age_s: float) -> None:
        is_old = age_s > _OLD_S and not chunk.is_kept
        with self._lock:
            for record in records:
                topic = self._members.get((link_name, record.member))
                if topic is None:
                    self.unknown += 1
                elif chunk.session != self._session or record.writer not in topic.by_number:
                    topic.held.append(_Held(chunk.session, record, self._clock()))
                elif 0 < topic.by_number[record.writer].offer.lifespan_ns < age_s * 1e9:
                    self.outdated += 1
                else:
                    self.outdated += topic.old.pop(record.writer, None) is not None
                    if is_old:
                        topic.old[record.writer] = record, self._clock() + _NEWER_S
                    else:
                        self._write(topic, record)

    def _write(self, topic: _Topic, record: Record) -> None:
        ghost = topic.by_number.get(record.writer)
        if ghost is not None and ghost.write(record):
            self.received += 1
        else:
            self.doubled += 1

    def _follow(self, name: str, offer: TopicOffer) -> None:
        topic = self._topics.get(name)
        if topic is not None and topic.offer.type_name != offer.type_name:
            self._drop(topic)
            topic = None
        kind = message_class(offer.type_name)
        here = definition_hash(kind) if offer.type_hash else ""
        if here and here != offer.type_hash:
            if topic is not None:
                self._drop(topic)
            raise UnknownTypeError(
                f"{offer.type_name} has another definition here ({here[:_HASH]}...) than there "
                f"({offer.type_hash[:_HASH]}...); build its package from one source on both ends"
            )
        if topic is None:
            topic = self._topics[name] = _Topic(name, offer)
        topic.offer = offer
        topic.by_number = {}
        planned = WriterQos(depth=offer.planned_depth, deadline_ns=offer.planned_deadline_ns)
        asked, sample_bytes = self._depths.get(name, DEFAULT_RELAY_DEPTH), expected_bytes(kind)
        # All that late readers of a latched topic get: of a map the newest.
        history = self._depths.get(name, 1 if sample_bytes == BULK_BYTES else DEFAULT_RELAY_DEPTH)
        for writer in offer.writers:
            ghost = topic.ghosts.get(writer.gid)
            if ghost is None:
                ghost = topic.ghosts[writer.gid] = GhostWriter(
                    self._nodes.of(self._side.local_name(writer.node), owner=_OWNER),
                    kind,
                    self._side.local_name(name),
                    writer,
                    depth=history if writer.is_latched else held_depth(asked, sample_bytes=sample_bytes),
                    planned=planned,
                    clock=self._clock,
                )
            # It may be alive now. Its ghost stays in its node, whatever an end that has just started calls that.
            ghost.offer = replace(writer, node=ghost.offer.node)
            ghost.retune(planned)
            topic.gone_s.pop(writer.gid, None)
            topic.by_number[writer.number] = ghost

    def _retire(self, topic: _Topic, present: set[str], now_s: float) -> None:
        """Remove the ghosts of writers that have been gone for a while."""
        for gid in topic.ghosts.keys() - present:
            if now_s - topic.gone_s.setdefault(gid, now_s) >= _GRACE_S:
                del topic.gone_s[gid]
                ghost = topic.ghosts.pop(gid)
                topic.by_number = {number: each for number, each in topic.by_number.items() if each is not ghost}
                ghost.destroy()
        if not topic.ghosts:
            self._drop(topic)

    def _drop(self, topic: _Topic) -> None:
        for ghost in topic.ghosts.values():
            ghost.destroy()
        del self._topics[topic.name]

    def _write_held(self, topic: _Topic, now_s: float) -> None:
        """Write the samples of writers that are known now; forget those that stay unknown."""
        for _ in range(len(topic.held)):
            held = topic.held.popleft()
            ghost = topic.by_number.get(held.record.writer) if held.session == self._session else None
            if ghost is not None:
                self.received += ghost.write(held.record)
            elif now_s - held.at_s < _HELD_S:
                topic.held.append(held)
            else:
                self.unknown += 1


def swap_some(ghosts: Iterable[GhostWriter], now_s: float) -> None:
    """Let some of the ghosts that are due ask for the plan's QoS."""
    for ghost in [ghost for ghost in ghosts if now_s >= ghost.due_s][:_MOST_SWAPS]:
        with suppress(ValueError):  # a reader here has a name or QoS that ROS cannot express
            ghost.swap()
