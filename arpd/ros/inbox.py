"""Messages of one topic of arpd's, which anybody on the network may send: what is none is counted and ignored."""

from __future__ import annotations

import logging
import time
from collections import Counter
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from std_msgs.msg import Float64MultiArray

from arpd.model.observation import MessageRefusal
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.price_message import decode_price
from arpd.ros.rate_limits import OncePerMinute, SourceRateLimiter
from arpd.ros.raw_reader import RawReader, ReadingThread, doubles

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.node import Node
    from rclpy.qos import QoSProfile

    from arpd.model.price import Price
    from arpd.ros.raw_reader import Sample

log = logging.getLogger(__name__)
_BURST_S = 2.0  # a writer may send what its rate gives in this time at once
_MOST_PRICE, _PRICES_HZ = 1024, 100.0  # bytes, and messages of one daemon; arpd sends 33 a second at most
T = TypeVar("T")


class Inbox(Generic[T]):
    """Reads a topic in the thread of the node's participant (`ReadingThread.of`); nobody needs to spin the node.

    A message that is too long, or that its writer sends too often, is never decoded.

    Parameters
    ----------
    node, msg_type, topic, qos : of its reader
    decode : returns what a sample holds; raises ValueError, which names the fault
    deliver : called with the GUID of its writer, and what it holds
    most_bytes : of a message
    most_hz : messages of one writer
    clock : monotonic clock (s)
    warn : says what was refused, once a minute of each writer and reason

    Attributes
    ----------
    refused : messages by reason
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        qos: QoSProfile,
        *,
        decode: Callable[[Sample], T],
        deliver: Callable[[bytes, T], None],
        most_bytes: int,
        most_hz: float,
        clock: Callable[[], float] = time.monotonic,
        warn: Callable[[str], None] = log.warning,
    ) -> None:
        self._topic = topic
        self._decode, self._deliver = decode, deliver
        self._most_bytes, self._most_hz = most_bytes, most_hz
        self._clock = clock
        self._warn = warn
        self._limiter = SourceRateLimiter(rate_hz=most_hz, burst=most_hz * _BURST_S)
        self._logged = OncePerMinute()
        self.refused: Counter[MessageRefusal] = Counter()
        self._reader = RawReader(node, msg_type, topic, qos, deliver=self.take, thread=ReadingThread.of(node.context))

    def destroy(self) -> None:
        """Read no more."""
        self._reader.destroy()

    def take(self, sample: Sample) -> None:
        """Take a message."""
        if len(sample.data) > self._most_bytes:
            self.refuse(MessageRefusal.SIZE, sample.writer, "a message is longer than any honest one")
        elif not self._limiter.lets_pass(sample.writer, self._clock()):
            self.refuse(MessageRefusal.RATE, sample.writer, f"one writer sends more than {self._most_hz:g} a second")
        else:
            try:
                found = self._decode(sample)
            except ValueError as fault:
                self.refuse(MessageRefusal.MALFORMED, sample.writer, str(fault))
                return
            self._deliver(sample.writer, found)

    def refuse(self, reason: MessageRefusal, source: Hashable, words: str) -> None:
        """Count a message that is not believed, and say why."""
        self.refused[reason] += 1
        if self._logged.take((reason, source), self._clock()):
            self._warn(f"ignored on {self._topic} (logged once a minute): {words}")


def price_inbox(
    node: Node, qos: QoSProfile, *, deliver: Callable[[bytes, Price], None], **options: Any
) -> Inbox[Price]:
    """Return an inbox for the prices of daemons; the arguments are those of `Inbox`."""
    return Inbox(
        node,
        Float64MultiArray,
        PRICE_TOPIC,
        qos,
        decode=lambda sample: decode_price(doubles(sample.data)),
        deliver=deliver,
        most_bytes=_MOST_PRICE,
        most_hz=_PRICES_HZ,
        **options,
    )
