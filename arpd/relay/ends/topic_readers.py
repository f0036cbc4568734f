"""The readers of one topic of the local domain: one for each class of its writers."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.qos import QoSLivelinessPolicy, QoSProfile

from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.depths import MOST_BYTES, held_depth
from arpd.relay.ends.types import expected_bytes
from arpd.ros.events import InvalidHandle, status_of
from arpd.ros.graph import policies_of
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.node import Node

    from arpd.relay.ends.survey import Survey
    from arpd.relay.offers import WriterOffer

_MOST_HELD = 1000
_HELD_S = 3.0

_LIVELINESS = QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED


class WriterClass(NamedTuple):
    """Writers that one reader hears."""

    is_reliable: bool
    is_latched: bool
    lease_ns: int  # of those that assert their liveliness by topic; 0 = the others


class _Held(NamedTuple):
    """A sample whose writer the graph does not name yet."""

    writers: WriterClass  # that its reader hears
    sample: Sample
    at_s: float


class TopicReaders:
    """Reads one topic, each sample with its writer.

    Each class of writers (reliable or not, latched or not, asserting their liveliness by topic or not) has a reader of
    its own, of which the samples of that class count only. So a reliable writer stays reliable when a best-effort one
    joins, and no reader is ever replaced.

    Parameters
    ----------
    node : node of the readers
    topic : its fully qualified name
    msg_type : message class
    survey : names the writers
    thread : takes the samples
    deliver : called with every sample and its writer, in the thread, one at a time
    depth : most samples that wait for the thread; None = a second of them
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        msg_type: Any,
        *,
        survey: Survey,
        thread: ReadingThread,
        deliver: Callable[[WriterOffer, Sample], None],
        depth: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._topic, self._msg_type = node, topic, msg_type
        self._survey, self._thread, self._deliver_one = survey, thread, deliver
        self._depth, self._clock = depth, clock
        self._readers: dict[WriterClass, RawReader] = {}
        self._held: deque[_Held] = deque(maxlen=_MOST_HELD)
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._readers)

    def follow(self, writers: Iterable[WriterOffer]) -> None:
        """Read every class of these writers, and deliver what waited for their names."""
        for each in {_class_of(writer) for writer in writers} - self._readers.keys():
            self._read(each)
        with self._lock:
            self._deliver_held()

    def destroy(self) -> None:
        """Destroy the readers; a sample may still be delivered while this is called."""
        while self._readers:
            self._readers.popitem()[1].destroy()

    def are_alive(self, writer: WriterOffer) -> bool:
        """Return whether a writer like this one asserts its liveliness within its lease; DDS does not say which."""
        try:
            status = status_of(self._readers[_class_of(writer)], _LIVELINESS)
        except (KeyError, InvalidHandle):  # it is not read, or begins again
            return False
        return status is not None and status.alive_count > 0

    def _read(self, writers: WriterClass) -> None:
        def deliver(sample: Sample) -> None:
            with self._lock:
                # Behind those that are held, perhaps of the same writer.
                if self._held or not self._deliver(writers, sample):
                    self._held.append(_Held(writers, sample, self._clock()))
                    self._deliver_held()

        liveliness = QoSLivelinessPolicy.MANUAL_BY_TOPIC if writers.lease_ns else QoSLivelinessPolicy.AUTOMATIC
        depth = held_depth(self._depth or DEFAULT_RELAY_DEPTH, sample_bytes=expected_bytes(self._msg_type))
        self._readers[writers] = RawReader(
            self._node,
            self._msg_type,
            self._topic,
            QoSProfile(
                depth=depth,
                liveliness=liveliness,
                liveliness_lease_duration=Duration(nanoseconds=writers.lease_ns),
                **policies_of(is_reliable=writers.is_reliable, is_latched=writers.is_latched),
            ),
            deliver=deliver,
            thread=self._thread,
            most_held_bytes=None if self._depth else MOST_BYTES,
        )

    def _deliver(self, writers: WriterClass, sample: Sample) -> bool:
        """Deliver a sample if its writer is of the reader's class; return whether the graph names the writer."""
        gid = sample.writer.hex()
        surveyed = self._survey.topics.get(self._topic)
        if surveyed is None or gid not in surveyed.known:
            surveyed = self._survey.read(self._topic)
        writer = surveyed.known.get(gid) if surveyed is not None else None
        if writer is None:
            return False
        if _class_of(writer) == writers:
            self._deliver_one(writer, sample)
        return True

    def _deliver_held(self) -> None:
        """Deliver the samples whose writer is known by now, each writer's in their order."""
        now_s = self._clock()
        unknown: set[bytes] = set()
        for _ in range(len(self._held)):
            held = self._held.popleft()
            if held.sample.writer in unknown or not self._deliver(held.writers, held.sample):
                unknown.add(held.sample.writer)
                if now_s - held.at_s < _HELD_S:
                    self._held.append(held)


def _class_of(writer: WriterOffer) -> WriterClass:
    return WriterClass(writer.is_reliable, writer.is_latched, writer.lease_ns if writer.is_manual else 0)
