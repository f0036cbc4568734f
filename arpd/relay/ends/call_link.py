"""Records of calls on the link: a topic of weight 1 in the paced queue, of which none is dropped."""

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

log = logging.getLogger(__name__)
_QOS = QoSProfile(depth=1000)  # reliable; calls repeat themselves, so an overflow costs time only


class CallLink:
    """Writes the records of this end's calls to the link, and reads those of the other end.

    Parameters
    ----------
    link_node : the end's node in the domain of the link
    link : writes to the link
    thread : takes the records
    own, other : topics of this end's records and of the other's
    """

    def __init__(self, link_node: Node, link: LinkThread, thread: ReadingThread, *, own: str, other: str) -> None:
        self._link_node, self._link, self._thread, self._other = link_node, link, thread, other
        self._logged = OncePerMinute()
        self._assembly = Assembly()
        self._reader: RawReader | None = None
        publisher = link_node.create_publisher(UInt8MultiArray, own, _QOS, event_callbacks=no_publisher_events())
        self._lane = Lane(rcl().outlet(publisher.handle).publish, is_kept=True)
        link.add(self._lane)

    def open(self, deliver: Callable[[int, bytes], None]) -> None:
        """Begin to read: ``deliver`` is called with the session of the sender and the record, in the thread."""

        def arrive(sample: Sample) -> None:
            try:
                chunk, _ = self._link.arrived(sample.data)
            except ValueError as fault:
                if self._logged.take("chunk", time.monotonic()):
                    log.warning("a record of the other end was ignored: %s (logged once a minute)", fault)
                return
            if (record := self._assembly.add(chunk)) is not None:
                deliver(chunk.session, record)

        self._reader = RawReader(
            self._link_node, UInt8MultiArray, self._other, _QOS, deliver=arrive, thread=self._thread
        )

    def send(self, record: bytes, source: int) -> None:
        """Let a record wait for its turn, in the place of one of this source; a large one on its way is not repeated.

        Calls repeat themselves once a second, and a large answer takes longer.
        """
        if len(record) <= SMALL_BYTES or not self._link.is_sending(self._lane, source):
            self._link.offer(self._lane, record, source=source)

    def close(self) -> None:
        """Destroy the reader."""
        if self._reader is not None:
            self._reader.destroy()
