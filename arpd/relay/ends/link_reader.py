"""Readers of the other end's topics on the link."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.relay.envelope import Assembly
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.relay.ends.link_thread import LinkThread
    from arpd.relay.envelope import Chunk

log = logging.getLogger(__name__)
#: Reliable. The thread takes samples at once, so this bridges its scheduling only; and calls repeat themselves.
LINK_QOS = QoSProfile(depth=1000)


class LinkReader:
    """Puts the messages of one topic of the other end together.

    Parameters
    ----------
    node : the end's node in the domain of the link
    topic : its name there
    link : accounts for what arrives
    thread : takes the chunks
    deliver : called in the thread with each message, its last chunk, and the age of that (s); ValueError = no such
        message. It must not wait: the receipts of all chunks would come late, as if the link was out
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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._topic, self._link, self._deliver, self._is_together = topic, link, deliver, is_together
        self._clock = clock
        self._assembly = Assembly()
        self._logged = OncePerMinute()
        self._reader = RawReader(node, UInt8MultiArray, topic, LINK_QOS, deliver=self._take, thread=thread)

    def destroy(self) -> None:
        """Destroy the reader."""
        self._reader.destroy()

    def _take(self, sample: Sample) -> None:
        try:
            chunk, age_s = self._link.arrived(sample.data, is_together=self._is_together)
            if (message := self._assembly.add(chunk)) is not None:
                self._deliver(message, chunk, age_s)
        except ValueError as fault:
            if self._logged.take("", self._clock()):
                log.warning("ignored a message of %s: %s (logged once a minute)", self._topic, fault)
