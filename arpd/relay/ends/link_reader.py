"""Readers of the other end's topics on the link."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.relay.envelope import Assembly
from arpd.ros.events import no_publisher_events
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.ends.link_thread import LinkThread
    from arpd.relay.envelope import Chunk

log = logging.getLogger(__name__)
# Reliable. The thread takes samples at once, so this bridges its scheduling only; and calls repeat themselves.
_QOS = QoSProfile(depth=1000)


class LinkReader:
    """Puts the messages of one topic of the other end together.

    Parameters
    ----------
    node : the end's node in the domain of the link
    topic : its name there
    link : accounts for what arrives
    thread : takes the chunks
    deliver : called in the thread with each message, its last chunk, and the age of that (s); ValueError = no such
        message
    is_together : whether its messages hold small ones of several topics
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        link: LinkThread,
        thread: ReadingThread,
        deliver: Callable[[bytes, Chunk, float], None],
        is_together: bool = False,
    ) -> None:
        self._topic, self._link, self._deliver, self._is_together = topic, link, deliver, is_together
        self._assembly = Assembly()
        self._logged = OncePerMinute()
        self._reader = RawReader(node, UInt8MultiArray, topic, _QOS, deliver=self._take, thread=thread)

    def destroy(self) -> None:
        """Destroy the reader."""
        self._reader.destroy()

    def _take(self, sample: Sample) -> None:
        try:
            chunk, age_s = self._link.arrived(sample.data, is_together=self._is_together)
            if (message := self._assembly.add(chunk)) is not None:
                self._deliver(message, chunk, age_s)
        except ValueError as fault:
            if self._logged.take("", time.monotonic()):
                log.warning("ignored a message of %s: %s (logged once a minute)", self._topic, fault)


class CallLink:
    """Writes the records of this end's calls to the link, and reads those of the other end.

    They are a topic of weight 1 in the paced queue, of which none is dropped.

    Parameters
    ----------
    node : the end's node in the domain of the link
    link : writes to the link
    thread : takes the records of the other end
    own, other : topics of this end's records and of the other's
    """

    def __init__(self, node: Node, link: LinkThread, thread: ReadingThread, *, own: str, other: str) -> None:
        self._node, self._link, self._thread, self._other = node, link, thread, other
        publisher = node.create_publisher(UInt8MultiArray, own, _QOS, event_callbacks=no_publisher_events())
        self._lane = Lane(rcl().outlet(publisher.handle).publish, is_kept=True)
        link.add(self._lane)

    def reader(self, deliver: Callable[[int, bytes], None]) -> LinkReader:
        """Read the other end's records: ``deliver`` is called with the session of the sender and the record.

        That must not wait: the receipts of all chunks would come late, as if the link was out.
        """
        return LinkReader(
            self._node,
            self._other,
            link=self._link,
            thread=self._thread,
            deliver=lambda record, chunk, _age_s: deliver(chunk.session, record),
        )

    def send(self, record: bytes, source: int) -> None:
        """Let a record wait for its turn, in the place of one of this source; a large one on its way is not repeated.

        Calls repeat themselves once a second, and a large answer takes longer.
        """
        if len(record) <= SMALL_BYTES or not self._link.is_sending(self._lane, source):
            self._link.offer(self._lane, record, source=source)
