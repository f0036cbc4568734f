"""One topic of the local domain: its writers, and a reader for each class of them."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.qos import QoSLivelinessPolicy, QoSProfile

from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.offers import WriterOffer
from arpd.relay.ends.types import MOST_BYTES, held_depth
from arpd.ros.graph import Endpoint, policies_of
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rcl import InvalidHandle, status_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.relay.ends.offers import WriterClass
    from arpd.ros.graph import GraphView

_NAMELESS_S = 2.0  # a writer without a node for so long never has one
_REMEMBERED_S = 30.0  # a writer that left
_TOLD_S = 1.0  # a writer that left is offered so long: its samples need its name there
_GONE_S = 0.3  # a sample whose writer no look finds for so long is of one that has left
_MOST_SOUGHT = 100
_TOLD = ("node", "is_reliable", "is_latched", "deadline_ns", "lifespan_ns", "lease_ns", "is_manual")
_MOST_HELD = 1000
_HELD_S = 3.0
_LIVELINESS = QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED


class Surveyed:
    """One topic: types and writers of other processes than this one, as they were read last.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.

    Parameters
    ----------
    local : the topic's name there
    """

    def __init__(self, view: GraphView, local: str) -> None:
        self._view, self.local = view, local
        self._lock = threading.Lock()
        self.types: tuple[str, ...] = ()
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self.writers: tuple[WriterOffer, ...] = ()
        self.known: Mapping[bytes, WriterOffer] = {}  # by GUID, with those that left, whose samples may still come
        self._left_s: dict[bytes, float] = {}
        # Whether to read although nothing changes: for the first time, or because a node may become known, or be told.
        self.is_waiting = True
        self._sought: deque[bytes] = deque(maxlen=_MOST_SOUGHT)  # writers of which a sample came first
        self._unnamed_s: dict[bytes, float] = {}  # writers whose node is not known, and since when

    def look(self, *, has_changed: bool) -> None:
        """Read the writers, if the graph has changed since the last look, or somebody waits for a node."""
        if has_changed or self.is_waiting:
            self._read()

    def writer(self, gid: bytes) -> WriterOffer | None:
        """Return the writer with this GUID, after another look where it is not known; for any thread."""
        if gid not in self.known:
            self._view.look()
            with self._lock:
                if gid not in self._sought:  # the script that wrote it may be gone before the next look
                    self._sought.append(gid)
                    self._view.writers_now(self.local)
            self._read()
        return self.known.get(gid)

    def adopt(self, gid: bytes, kind: WriterClass) -> None:
        """Offer a writer that had left before a look found it, as one of no node, by the class that heard it."""
        is_reliable, is_latched, lease_ns = kind
        with self._lock:
            is_ours = Endpoint(gid=gid).participant in self._view.ours
            if is_ours or gid in self.known or gid in self._unnamed_s:
                return
            offer = WriterOffer(
                node="",
                gid=gid.hex(),
                is_reliable=is_reliable,
                is_latched=is_latched,
                lease_ns=lease_ns,
                is_manual=lease_ns > 0,
            )
            self.known = {**self.known, gid: offer}
        self._read()

    def _read(self) -> None:
        with self._lock:
            ours = self._view.ours
            others = [each for each in self._view.writers(self.local) if each.participant not in ours]
            self.read(others, time.monotonic())

    def read(self, writers: Collection[Endpoint], now_s: float) -> None:
        """Take the writers of the topic, at this time of the monotonic clock."""
        self._unnamed_s = {each.gid: self._unnamed_s.get(each.gid, now_s) for each in writers if not each.is_named}
        waiting = {gid for gid, since_s in self._unnamed_s.items() if now_s - since_s < _NAMELESS_S}
        self.is_waiting = bool(waiting)
        named = [each for each in writers if each.gid not in waiting]
        self.types = tuple(sorted({each.type_name for each in named}))
        known = self.known
        if named and self.type_name not in self.types:  # a stray writer of another type stops nothing that flows
            if self.type_name:
                known = {}  # what has left is of another type
            self.type_name = self.types[0] if len(self.types) == 1 else ""
        offered = [each for each in named if each.type_name == self.type_name]
        hashes = {each.type_hash for each in offered} - {""}
        if named:  # else what has left is offered as it was
            self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        present = {each.gid: _offer(each) for each in sorted(offered, key=lambda each: each.gid)}
        self._left_s = {gid: self._left_s.get(gid, now_s) for gid in known.keys() - present}
        left = {gid: known[gid] for gid, left_s in self._left_s.items() if now_s - left_s < _REMEMBERED_S}
        self.known = left | present
        brief = [each for gid, each in left.items() if now_s - self._left_s[gid] < _TOLD_S]
        self.is_waiting |= bool(brief)
        self.writers = (*present.values(), *brief)


def _offer(found: Endpoint) -> WriterOffer:
    return WriterOffer(gid=found.gid.hex(), **{name: getattr(found, name) for name in _TOLD})


class TopicReaders:
    """Reads one topic, each sample with its writer.

    Each class of writers (reliable or not, latched or not, asserting their liveliness by topic or not) has a reader of
    its own, of which the samples of that class count only. So a reliable writer stays reliable when a best-effort one
    joins, and no reader is ever replaced.

    Parameters
    ----------
    topic : names the writers
    deliver : called with every sample and its writer, in the thread, one at a time
    on_missed : called before, with the number of samples that this computer was too busy to read, if there are any
    depth : most samples that wait for the thread; None = a second of them
    is_kept : as of `RawReader`; so are those of latched writers, and of a topic with a depth of its own
    """

    def __init__(
        self,
        node: Node,
        topic: Surveyed,
        msg_type: Any,
        *,
        thread: ReadingThread,
        deliver: Callable[[WriterOffer, Sample], None],
        on_missed: Callable[[int], None],
        depth: int | None,
        is_kept: bool,
    ) -> None:
        self._node, self._topic, self._msg_type = node, topic, msg_type
        self._thread, self._deliver_one, self._on_missed = thread, deliver, on_missed
        self._depth, self._is_kept = depth, is_kept
        self._readers: dict[WriterClass, RawReader] = {}
        self._followed: tuple[WriterOffer, ...] = ()
        # Samples whose writer the graph does not name yet, the class that their reader hears, and when they came.
        self._held: deque[tuple[WriterClass, Sample, float]] = deque(maxlen=_MOST_HELD)
        self._heard: dict[bytes, int] = {}  # writers of which a sample was delivered, and its number
        self._lock = threading.Lock()

    def follow(self, writers: tuple[WriterOffer, ...]) -> None:
        """Read every class of these writers, and deliver what waited for their names."""
        if writers != self._followed:
            for kind in {writer.kind for writer in writers} - self._readers.keys():
                self._readers[kind] = self._reader(kind)
            self._followed = writers
            with self._lock:
                self._heard = {gid: self._heard[gid] for gid in self._heard.keys() & self._topic.known.keys()}
        if self._held:
            with self._lock:
                self._deliver_held()

    def destroy(self) -> None:
        """Destroy the readers; a sample may still be delivered while this is called."""
        while self._readers:
            self._readers.popitem()[1].destroy()

    def are_alive(self, writer: WriterOffer) -> bool:
        """Return whether a writer like this one asserts its liveliness within its lease; DDS does not say which."""
        try:
            status = status_of(self._readers[writer.kind], _LIVELINESS)
        except (KeyError, InvalidHandle):  # it is not read, or begins again
            return False
        return status is not None and status.alive_count > 0

    def _reader(self, kind: WriterClass) -> RawReader:
        def deliver(sample: Sample) -> None:
            with self._lock:
                if not self._held and self._deliver(kind, sample):
                    return
                self._held.append((kind, sample, time.monotonic()))  # behind others, perhaps of the same writer
                self._deliver_held()

        is_reliable, is_latched, lease_ns = kind
        qos = QoSProfile(
            depth=held_depth(self._msg_type, asked=self._depth or DEFAULT_RELAY_DEPTH),
            liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC if lease_ns else QoSLivelinessPolicy.AUTOMATIC,
            liveliness_lease_duration=Duration(nanoseconds=lease_ns),
            **policies_of(is_reliable=is_reliable, is_latched=is_latched),
        )
        return RawReader(
            self._node,
            self._msg_type,
            self._topic.local,
            qos,
            deliver=deliver,
            thread=self._thread,
            most_held_bytes=None if self._depth else MOST_BYTES,
            is_kept=self._is_kept or self._depth is not None or is_latched,
        )

    def _deliver(self, kind: WriterClass, sample: Sample) -> bool:
        """Deliver a sample if its writer is of the reader's class; return whether the graph names the writer."""
        writer = self._topic.writer(sample.writer)
        if writer is not None and writer.kind == kind:
            if (missed := sample.sequence - self._heard.get(sample.writer, sample.sequence) - 1) > 0:
                self._on_missed(missed)
            self._heard[sample.writer] = sample.sequence
            self._deliver_one(writer, sample)
        return writer is not None

    def _deliver_held(self) -> None:
        """Deliver the samples whose writer is known by now, each writer's in their order.

        So are the first samples of new writers: of two goals that scripts publish once, one after the other, the first
        one's writer may have left before a look finds it, and the second must not come before.
        """
        now_s = time.monotonic()
        unknown: set[bytes] = set()
        for _ in range(len(self._held)):
            kind, sample, at_s = self._held.popleft()
            waits = sample.writer in unknown or (unknown and sample.writer not in self._heard)
            if waits or not self._deliver(kind, sample):
                unknown.add(sample.writer)
                if now_s - at_s < _HELD_S:
                    self._held.append((kind, sample, at_s))
        kinds: dict[bytes, WriterClass] = {}  # of each writer the most that heard it
        for kind, sample, _ in self._held:
            kinds[sample.writer] = max(kind, kinds.get(sample.writer, kind))
        for gid in {sample.writer for _, sample, at_s in self._held if now_s - at_s >= _GONE_S}:
            self._topic.adopt(gid, kinds[gid])
