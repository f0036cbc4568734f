"""The readers of one topic of the local domain: one for each class of its writers."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.qos import QoSLivelinessPolicy, QoSProfile

from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.types import MOST_BYTES, held_depth
from arpd.ros.graph import policies_of
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rcl import InvalidHandle, status_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.ends.offers import WriterClass, WriterOffer
    from arpd.relay.ends.survey import Surveyed

_MOST_HELD = 1000
_HELD_S = 3.0
_LIVELINESS = QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED


class TopicReaders:
    """Reads one topic, each sample with its writer.

    Each class of writers (reliable or not, latched or not, asserting their liveliness by topic or not) has a reader of
    its own, of which the samples of that class count only. So a reliable writer stays reliable when a best-effort one
    joins, and no reader is ever replaced.

    Parameters
    ----------
    topic : names the writers
    deliver : called with every sample and its writer, in the thread, one at a time
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
        depth: int | None,
        is_kept: bool,
    ) -> None:
        self._node, self._topic, self._msg_type = node, topic, msg_type
        self._thread, self._deliver_one = thread, deliver
        self._depth, self._is_kept = depth, is_kept
        self._readers: dict[WriterClass, RawReader] = {}
        self._followed: tuple[WriterOffer, ...] = ()
        # Samples whose writer the graph does not name yet, the class that their reader hears, and when they came.
        self._held: deque[tuple[WriterClass, Sample, float]] = deque(maxlen=_MOST_HELD)
        self._lock = threading.Lock()

    def follow(self, writers: tuple[WriterOffer, ...]) -> None:
        """Read every class of these writers, and deliver what waited for their names."""
        if writers != self._followed:
            for kind in {writer.kind for writer in writers} - self._readers.keys():
                self._readers[kind] = self._reader(kind)
            self._followed = writers
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
            self._deliver_one(writer, sample)
        return writer is not None

    def _deliver_held(self) -> None:
        """Deliver the samples whose writer is known by now, each writer's in their order."""
        now_s = time.monotonic()
        unknown: set[bytes] = set()
        for _ in range(len(self._held)):
            kind, sample, at_s = self._held.popleft()
            if sample.writer in unknown or not self._deliver(kind, sample):
                unknown.add(sample.writer)
                if now_s - at_s < _HELD_S:
                    self._held.append((kind, sample, at_s))
