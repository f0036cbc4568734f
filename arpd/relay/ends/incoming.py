"""Topics that the other side offers: their ghosts, who reads them here, and their samples from the link."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import NameValidationException

from arpd.model.endpoints import WriterQos
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.ghosts import GhostNodes, GhostWriter
from arpd.relay.ends.types import MOST_BYTES, UnknownTypeError, held_depth, is_bulk, message_class, require_same
from arpd.relay.envelope import Chunk, Record, unpack, writer_key
from arpd.ros.names import on_link
from arpd.ros.raw_reader import LATE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.relay.ends.link import LinkReader
    from arpd.relay.ends.offers import TopicOffer, WriterOffer
    from arpd.relay.selection import Side

_LINGER_S = 5.0  # a topic that nobody reads any more crosses that long: a reader may just be restarting
# Samples of a writer that is gone may still be on their way, and an end that restarts knows no writer at first.
_GRACE_S = 5.0
_MOST_HELD = 5000
_HELD_S = 3.0
_NEWER_S = 0.3  # what an outage delayed comes within that; the newest of each source is delivered
_MOST_SWAPS = 5  # asked for in a step: each takes a millisecond under the lock, and is announced to every process


@dataclass(slots=True)
class _Ghost:
    writer: GhostWriter
    topic: str
    offer: TopicOffer
    read_s: float = -math.inf  # when somebody read it last


class Incoming:
    """Keeps a ghost of every offered writer, wants the topics that have readers, and writes what arrives.

    Parameters
    ----------
    reader : opens a reader of this topic on the link, which passes on what it reads
    depths : least KEEP_LAST depth of ghosts, by topic

    Attributes
    ----------
    refused : topics that cannot be carried, and why
    wants : topics that somebody reads here
    samples : as `RelaySummary` has them
    """

    def __init__(
        self,
        *,
        nodes: GhostNodes,
        reader: Callable[..., LinkReader],
        side: Side,
        depths: Mapping[str, int],
    ) -> None:
        self._nodes, self._reader, self._side, self._depths = nodes, reader, side, depths
        self._lock = threading.Lock()  # guards the ghosts: samples come in the reading thread
        self._ghosts: dict[bytes, _Ghost] = {}  # by what stands for their originals in samples
        # Samples of writers that no state has named yet: how old they were, whether that is late, and when they came.
        self._held: deque[tuple[Record, float, bool, float]] = deque(maxlen=_MOST_HELD)
        self._late: dict[bytes, tuple[Record, float]] = {}  # by writer: the last, and until when a newer one may come
        self._readers: dict[str, LinkReader] = {}  # by the name on the link
        self.refused: dict[str, str] = {}
        self.wants: frozenset[str] = frozenset()
        self.samples = Counter(received=0, doubled=0, unknown=0, outdated=0)

    def follow(self, offers: Mapping[str, TopicOffer], reason_against: Callable[[str, TopicOffer], str]) -> None:
        """Make the ghosts of what is offered now, and remove those of what no longer is.

        Parameters
        ----------
        offers : topics of the other side
        reason_against : returns why a topic does not enter, empty if it does; its ghosts go at once, because a reader
            would hear samples twice
        """
        now_s = time.monotonic()
        kinds: dict[str, Any] = {}
        self.refused = {name: reason for name, offer in offers.items() if (reason := reason_against(name, offer))}
        for name in offers.keys() - self.refused.keys():
            offer = offers[name]
            try:
                require_same(kind := message_class(offer.type_name), offer.type_name, offer.type_hash)
                kinds[name] = kind
            except UnknownTypeError as fault:
                self.refused[name] = str(fault)
        present = {writer_key(writer.gid) for name in kinds for writer in offers[name].writers}
        with self._lock:
            for key, ghost in [*self._ghosts.items()]:
                offer = offers.get(ghost.topic, ghost.offer)
                if ghost.topic in self.refused or offer.type_name != ghost.offer.type_name:
                    self._remove(key)
                elif key not in present:
                    ghost.writer.gone_s = min(ghost.writer.gone_s, now_s)
            for name, kind in kinds.items():
                try:
                    on_link(offers[name].link_name)  # else nobody could send it
                    for writer in offers[name].writers:
                        self._follow(name, offers[name], writer, kind)
                except (NameValidationException, RuntimeError, ValueError) as fault:
                    self.refused[name] = str(fault)
            for _ in range(len(self._held)):
                self._take(*self._held.popleft(), now_s)

    def step(self, *, is_reachable: bool) -> None:
        """Look for readers, and open or close what they need."""
        now_s = time.monotonic()
        with self._lock:
            for ghost in self._ghosts.values():
                ghost.writer.step(is_reachable=is_reachable)
                if ghost.writer.matched():
                    ghost.read_s = now_s
            read = [ghost for ghost in self._ghosts.values() if now_s - ghost.read_s < _LINGER_S]
            for writer in [writer for writer, (_, until_s) in self._late.items() if now_s >= until_s]:
                self._write(self._late.pop(writer)[0])
            for key in [key for key, each in self._ghosts.items() if now_s - each.writer.gone_s >= _GRACE_S]:
                self._remove(key)
            due = [ghost.writer for ghost in self._ghosts.values() if now_s >= ghost.writer.due_s]
            for each in due[:_MOST_SWAPS]:
                with suppress(ValueError):  # a reader here has a name or QoS that ROS cannot express
                    each.swap()
        self._nodes.tidy()
        links = {ghost.offer.link_name for ghost in read}
        for name in links - self._readers.keys():
            self._readers[name] = self._reader(on_link(name), deliver=self.deliver)
        for name in self._readers.keys() - links:
            self._readers.pop(name).destroy()
        self.wants = frozenset(ghost.topic for ghost in read)

    def deliver(self, message: bytes, chunk: Chunk, age_s: float) -> None:
        """Write the samples of a message; ValueError = it has none."""
        now_s, is_late = time.monotonic(), age_s > LATE_S and not chunk.is_kept
        with self._lock:
            for record in unpack(message):
                self._take(record, age_s, is_late, now_s, now_s)

    def close(self) -> None:
        """Destroy everything."""
        for reader in self._readers.values():
            reader.destroy()
        with self._lock:
            for key in [*self._ghosts]:
                self._remove(key)

    def _take(self, record: Record, age_s: float, is_late: bool, came_s: float, now_s: float) -> None:  # noqa: FBT001 - of a tuple
        """Write a sample, or hold it: for a while until its writer is known, or a late one until a newer one comes."""
        if (ghost := self._ghosts.get(record.writer)) is None:
            if now_s - came_s < _HELD_S:
                self._held.append((record, age_s, is_late, came_s))
            else:
                self.samples["unknown"] += 1
        elif 0 < ghost.writer.offer.lifespan_ns < (age_s + now_s - came_s) * 1e9:
            self.samples["outdated"] += 1
        else:
            replaced = self._late.pop(record.writer, None)
            self.samples["outdated"] += replaced is not None
            if is_late:  # where all are, as on a link with a queue of a second, the wait still ends
                self._late[record.writer] = record, replaced[1] if replaced else now_s + _NEWER_S
            else:
                self._write(record)

    def _write(self, record: Record) -> None:
        self.samples["received" if self._ghosts[record.writer].writer.write(record) else "doubled"] += 1

    def _follow(self, name: str, offer: TopicOffer, writer: WriterOffer, kind: Any) -> None:
        key = writer_key(writer.gid)
        planned = WriterQos(depth=offer.planned_depth, deadline_ns=offer.planned_deadline_ns)
        if (ghost := self._ghosts.get(key)) is None:
            make = partial(
                GhostWriter,
                msg_type=kind,
                topic=self._side.local_name(name),
                offer=writer,
                depth=self._depth(name, writer, kind),
                planned=planned,
                most_held_bytes=None if name in self._depths else MOST_BYTES,
            )
            made = self._nodes.give(self._side.local_name(writer.node), make)
            ghost = self._ghosts[key] = _Ghost(made, name, offer)
        ghost.offer = offer
        ghost.writer.follow(writer, planned)

    def _depth(self, name: str, writer: WriterOffer, kind: type) -> int:
        if writer.is_latched:  # all that late readers get: of a map the newest
            return self._depths.get(name, 1 if is_bulk(kind) else DEFAULT_RELAY_DEPTH)
        return held_depth(kind, asked=self._depths.get(name, DEFAULT_RELAY_DEPTH))

    def _remove(self, key: bytes) -> None:
        self._late.pop(key, None)
        self._ghosts.pop(key).writer.destroy()
