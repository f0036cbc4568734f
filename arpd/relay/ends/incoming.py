"""Topics that the other side offers: their ghosts, who reads them here, and their samples from the link."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rclpy.exceptions import NameValidationException

from arpd.model.endpoints import WriterQos
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.ghosts import GhostNodes, GhostWriter
from arpd.relay.ends.link import LinkReader
from arpd.relay.ends.types import UnknownTypeError, definition_hash, held_depth, is_bulk, message_class
from arpd.relay.envelope import Chunk, Record, unpack, writer_key

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.relay.ends.link import LinkThread
    from arpd.relay.ends.offers import TopicOffer, WriterOffer
    from arpd.relay.selection import Side
    from arpd.ros.raw_reader import ReadingThread

_OWNER = "topics"  # of ghost nodes
_LINGER_S = 5.0  # a topic that nobody reads any more crosses that long: a reader may just be restarting
# Samples of a writer that is gone may still be on their way, and an end that restarts knows no writer at first.
_GRACE_S = 5.0
_MOST_HELD = 5000
_HELD_S = 3.0
_OLD_S = 0.5  # on its way beyond the usual: an outage lay between
_NEWER_S = 0.3  # what an outage delayed comes within that; the newest sample of each source is delivered
_HASH = 15  # characters that tell two hashes apart
_MOST_SWAPS = 5  # asked for in a step: each takes a millisecond under the lock, and is announced to every process


@dataclass(slots=True)
class _Topic:
    """One topic that the other side offers; its ghosts by the GUIDs of their originals."""

    offer: TopicOffer
    ghosts: dict[str, GhostWriter] = field(default_factory=dict)
    read_s: float = -math.inf  # when somebody read it last


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

    Attributes
    ----------
    refused : topics that cannot be carried, and why
    wants : topics that somebody reads here
    received, doubled, unknown, outdated : samples, as `RelaySummary` has them
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
        self._link_node, self._nodes, self._thread, self._link = link_node, nodes, thread, link
        self._side, self._depths, self._clock = side, depths, clock
        self._lock = threading.Lock()  # guards the topics: samples come in the reading thread
        self._topics: dict[str, _Topic] = {}
        self._ghosts: dict[bytes, GhostWriter] = {}  # by what stands for their originals in samples
        self._held: deque[tuple[Record, float]] = deque(maxlen=_MOST_HELD)  # of writers that no state has named yet
        self._late: dict[bytes, tuple[Record, float]] = {}  # by writer: the last, and until when a newer one may come
        self._readers: dict[str, LinkReader] = {}  # by the name on the link
        self.refused: dict[str, str] = {}
        self.wants: frozenset[str] = frozenset()
        self.received = self.doubled = self.unknown = self.outdated = 0

    def follow(self, offers: Mapping[str, TopicOffer], *, refused: Collection[str] = frozenset()) -> None:
        """Make the ghosts of what is offered now, and remove those of what no longer is.

        Parameters
        ----------
        offers : topics of the other side that enter here
        refused : topics that do not enter; their ghosts go at once, because a reader would hear samples twice
        """
        now_s = self._clock()
        with self._lock:
            self.refused = {}
            for name in self._topics.keys() & set(refused):
                self._drop(name)
            for name, offer in offers.items():
                try:
                    self._follow(name, offer)
                except (UnknownTypeError, NameValidationException, RuntimeError, ValueError) as fault:
                    self.refused[name] = str(fault)
            for name, topic in list(self._topics.items()):
                present = {writer.gid for writer in offers[name].writers} if name in offers else set()
                for gid in topic.ghosts.keys() - present:
                    topic.ghosts[gid].gone_s = min(topic.ghosts[gid].gone_s, now_s)
            self._retire(now_s)
            self._write_held(now_s)

    def step(self, *, is_reachable: bool) -> None:
        """Look for readers, and open or close what they need."""
        now_s = self._clock()
        wants, links = set(), set()
        with self._lock:
            for name, topic in self._topics.items():
                for ghost in topic.ghosts.values():
                    ghost.step(is_reachable=is_reachable)
                    if ghost.matched():
                        topic.read_s = now_s
                if now_s - topic.read_s < _LINGER_S:
                    wants.add(name)
                    links.add(topic.offer.link_name)
            for writer in [writer for writer, (_, until_s) in self._late.items() if now_s >= until_s]:
                self._write(self._late.pop(writer)[0])
            self._retire(now_s)
            swap_some(self._ghosts.values(), now_s)
            nodes = {self._side.local_name(ghost.offer.node) for ghost in self._ghosts.values()}
        self._nodes.keep(_OWNER, nodes)
        for name in links - self._readers.keys():
            self._readers[name] = LinkReader(
                self._link_node, name, link=self._link, thread=self._thread, deliver=self.deliver, clock=self._clock
            )
        for name in self._readers.keys() - links:
            self._readers.pop(name).destroy()
        self.wants = frozenset(wants)

    def deliver(self, message: bytes, chunk: Chunk, age_s: float) -> None:
        """Write the samples of a message; ValueError = it has none."""
        now_s, is_late = self._clock(), age_s > _OLD_S and not chunk.is_kept
        with self._lock:
            for record in unpack(message):
                if (ghost := self._ghosts.get(record.writer)) is None:
                    self._held.append((record, now_s))
                elif 0 < ghost.offer.lifespan_ns < age_s * 1e9:
                    self.outdated += 1
                else:
                    self.outdated += self._late.pop(record.writer, None) is not None
                    if is_late:
                        self._late[record.writer] = record, now_s + _NEWER_S
                    else:
                        self._write(record)

    def close(self) -> None:
        """Destroy everything."""
        for reader in self._readers.values():
            reader.destroy()
        with self._lock:
            for name in [*self._topics]:
                self._drop(name)

    def _write(self, record: Record) -> None:
        ghost = self._ghosts.get(record.writer)
        if ghost is not None and ghost.write(record):
            self.received += 1
        else:
            self.doubled += 1

    def _write_held(self, now_s: float) -> None:
        """Write the samples of writers that are known now; forget those that stay unknown."""
        for _ in range(len(self._held)):
            record, at_s = self._held.popleft()
            if record.writer in self._ghosts:
                self._write(record)
            elif now_s - at_s < _HELD_S:
                self._held.append((record, at_s))
            else:
                self.unknown += 1

    def _follow(self, name: str, offer: TopicOffer) -> None:
        topic = self._topics.get(name)
        kind = message_class(offer.type_name)
        here = definition_hash(kind) if offer.type_hash else ""
        is_other = here != offer.type_hash
        if topic is not None and (is_other or topic.offer.type_name != offer.type_name):
            self._drop(name)
            topic = None
        if is_other:
            raise UnknownTypeError(
                f"{offer.type_name} has another definition here ({here[:_HASH]}...) than there "
                f"({offer.type_hash[:_HASH]}...); build its package from one source on both ends"
            )
        if topic is None:
            topic = self._topics[name] = _Topic(offer)
        topic.offer = offer
        planned = WriterQos(depth=offer.planned_depth, deadline_ns=offer.planned_deadline_ns)
        for writer in offer.writers:
            ghost = topic.ghosts.get(writer.gid)
            if ghost is None:
                ghost = topic.ghosts[writer.gid] = GhostWriter(
                    self._nodes.of(self._side.local_name(writer.node), owner=_OWNER),
                    kind,
                    self._side.local_name(name),
                    writer,
                    depth=self._depth(name, writer, kind),
                    planned=planned,
                    clock=self._clock,
                )
                self._ghosts[writer_key(writer.gid)] = ghost
            ghost.follow(writer, planned)

    def _depth(self, name: str, writer: WriterOffer, kind: type) -> int:
        if writer.is_latched:  # all that late readers get: of a map the newest
            return self._depths.get(name, 1 if is_bulk(kind) else DEFAULT_RELAY_DEPTH)
        return held_depth(kind, asked=self._depths.get(name, DEFAULT_RELAY_DEPTH))

    def _retire(self, now_s: float) -> None:
        """Remove the ghosts of writers that have been gone for a while."""
        for name, topic in [*self._topics.items()]:
            for gid in [gid for gid, ghost in topic.ghosts.items() if now_s - ghost.gone_s >= _GRACE_S]:
                self._remove(topic, gid)
            if not topic.ghosts:
                del self._topics[name]

    def _drop(self, name: str) -> None:
        topic = self._topics.pop(name)
        for gid in [*topic.ghosts]:
            self._remove(topic, gid)

    def _remove(self, topic: _Topic, gid: str) -> None:
        self._ghosts.pop(writer_key(gid), None)
        topic.ghosts.pop(gid).destroy()


def swap_some(ghosts: Iterable[GhostWriter], now_s: float) -> None:
    """Let some of the ghosts that are due ask for the plan's QoS."""
    for ghost in [ghost for ghost in ghosts if now_s >= ghost.due_s][:_MOST_SWAPS]:
        with suppress(ValueError):  # a reader here has a name or QoS that ROS cannot express
            ghost.swap()
