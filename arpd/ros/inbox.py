"""Messages of one topic of arpd's, which anybody on the network may send: what is none is counted and ignored."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.model.observation import MessageRefusal
from arpd.ros.cdr import doubles, octets
from arpd.ros.names import PRICE_TOPIC
from arpd.ros.price_message import decode_price
from arpd.ros.rate_limits import OncePerMinute, RateLimit
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.node import Node
    from rclpy.qos import QoSProfile

log = logging.getLogger(__name__)
_PERIOD_S = 2.0  # a writer may send what its rate gives in this time at once
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Letters(Generic[T]):
    """What arrives on one of arpd's topics.

    Parameters
    ----------
    topic, msg_type : its name, and the class of its messages: an array
    decode : returns what the content of the array says; raises ValueError, which names the fault
    most_bytes : of an honest message
    most_hz : messages of an honest writer
    weigh : returns for how many more messages of its writer one counts that took long to read, and so it gets None for
        one that could not be read
    """

    topic: str
    msg_type: Any = UInt8MultiArray
    decode: Callable[[Any], T]
    most_bytes: int
    most_hz: float
    weigh: Callable[[T | None], float] = lambda _found: 0.0


#: A daemon sends 33 prices a second at most.
PRICES = Letters(topic=PRICE_TOPIC, msg_type=Float64MultiArray, decode=decode_price, most_bytes=1024, most_hz=100.0)


class Inbox(Generic[T]):
    """Reads a topic in the thread of the node's participant (`ReadingThread.of`); nobody needs to spin the node.

    A message that is too long, or that its writer sends too often, is never decoded.

    Parameters
    ----------
    deliver : called with a sample, and what it says
    clock : monotonic clock (s)
    warn : says what was refused, once a minute of each writer and reason

    Attributes
    ----------
    refused : messages by reason
    """

    def __init__(
        self,
        node: Node,
        letters: Letters[T],
        qos: QoSProfile,
        deliver: Callable[[Sample, T], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        warn: Callable[[str], None] = log.warning,
    ) -> None:
        self._letters, self._deliver = letters, deliver
        self._content: Callable[[bytes], Any] = octets if letters.msg_type is UInt8MultiArray else doubles
        self._clock = clock
        self._warn = warn
        self._limit = RateLimit(letters.most_hz * _PERIOD_S, period_s=_PERIOD_S)
        self._logged = OncePerMinute()
        self.refused: Counter[MessageRefusal] = Counter()
        thread = ReadingThread.of(node.context)
        self._reader = RawReader(node, letters.msg_type, letters.topic, qos, deliver=self.take, thread=thread)

    def destroy(self) -> None:
        """Read no more."""
        self._reader.destroy()

    def take(self, sample: Sample) -> None:
        """Take a message."""
        letters = self._letters
        if len(sample.data) > letters.most_bytes:
            self.refuse(MessageRefusal.SIZE, sample.writer, "a message is longer than any honest one")
        elif not self._limit.take(sample.writer, self._clock()):
            self.refuse(MessageRefusal.RATE, sample.writer, f"one writer sends more than {letters.most_hz:g} a second")
        else:
            found = None
            try:
                found = letters.decode(self._content(sample.data))
            except ValueError as fault:
                self.refuse(MessageRefusal.MALFORMED, sample.writer, str(fault))
                return
            finally:
                self._limit.charge(sample.writer, letters.weigh(found))
            self._deliver(sample, found)

    def refuse(self, reason: MessageRefusal, source: Hashable, words: str) -> None:
        """Count a message that is not believed, and say why."""
        self.refused[reason] += 1
        if self._logged.take((reason, source), self._clock()):
            self._warn(f"ignored on {self._letters.topic} (logged once a minute): {words}")
