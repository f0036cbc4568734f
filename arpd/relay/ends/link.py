"""The link as an end uses it: one thread that writes everything, and readers that put messages together."""

from __future__ import annotations

import logging
import math
import time
from functools import partial
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.writing_thread import WritingThread
from arpd.relay.envelope import Assembly, Chunk
from arpd.relay.link_queue import LinkQueue
from arpd.ros.cdr import wrap
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample
from arpd.ros.rcl import NO_EVENTS, Outlet

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.node import Node

    from arpd.endpoint.lane import Lane

log = logging.getLogger(__name__)
#: Reliable. The thread takes samples at once, so this bridges its scheduling only; and calls repeat themselves.
LINK_QOS = QoSProfile(depth=1000)
#: Chunks that DDS keeps until they are acknowledged: more than may be on their way (`Flight`).
LINK_DEPTH = 400


class LinkThread(WritingThread):
    """Writes to the link, and accounts for what arrives from it; nobody else waits for a write.

    Parameters
    ----------
    state : writes a state of the end, reliably
    sign : writes one sign of life, best effort
    together : writes small messages that leave together, reliably
    freight : writes chunks in datagrams, reliably

    Attributes
    ----------
    queue : what waits, and the account of what is on its way
    partner_gids : first bytes of the GUIDs of the other end's readers, in hexadecimal digits; empty = not known
    """

    def __init__(
        self,
        session: int,
        *,
        state: Callable[[bytes], None],
        sign: Callable[[bytes], None],
        together: Callable[[bytes], None],
        freight: Callable[[bytes], None],
    ) -> None:
        self.queue = LinkQueue(
            session,
            time.monotonic(),
            together=together,
            freight=freight,
            asleep_s=lambda: lasting_s() - time.monotonic(),
        )
        super().__init__(self.queue, name="arpd-link", warn=log.error)
        self._write_state, self._write_sign = state, sign
        self.partner_gids = ""
        self._state: bytes | None = None  # that waits; a newer one takes its place

    def has(self, lane: Lane, source: Hashable) -> bool:
        """Return whether a message of this source waits, is on its way, or was just now."""
        with self._changed:
            return lane.has(source, self._clock())

    def tell(self, state: bytes) -> None:
        """Write a state of the end, before all that waits."""
        with self._changed:
            self._state = state
            self._wake(0.0)

    def follow(self, partner: int, gids: str) -> None:
        """Take the session of the other end, 0 = there is none, and the first bytes of its GUIDs."""
        self.partner_gids = gids
        with self._changed:
            if self.queue.follow(partner, self._clock()):
                self._wake(0.0)

    def make_way(self) -> None:
        """Let large messages wait a moment; `LinkQueue.make_way` says more."""
        with self._changed:
            self.queue.make_way(self._clock())

    def arrived(self, sample: bytes, **how: bool) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; `LinkQueue.arrived` says more."""
        with self._changed:
            arrived = self.queue.arrived(sample, self._clock(), **how)
            self._wake(self.queue.sign_s)
        return arrived

    def hear(self, sign: bytes) -> int:
        """Take a sign of life of the other end; `LinkQueue.hear` says more."""
        with self._changed:
            session = self.queue.hear(sign, self._clock())
            self._wake(0.0)
        return session

    def _choose(self, now_s: float) -> Callable[[], object] | None:
        if (sign := self.queue.take_sign(now_s)) is not None:
            return partial(self._write_sign, wrap(sign))
        if self._state is not None and now_s < self.queue.flight.out_s:
            state, self._state = self._state, None
            return partial(self._write_state, wrap(state))
        act = super()._choose(now_s)
        self.queue.note_held(now_s)
        return act

    def _due_s(self, now_s: float) -> float:
        return min(self.queue.sign_s, super()._due_s(now_s))


def lasting_s() -> float:
    """Return the time of a clock that goes on while this computer sleeps (s)."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class FreightWriter:
    """Writes chunks in datagrams; where these do not arrive, by a new writer: DDS would go on to repeat them.

    Parameters
    ----------
    topic : in the domain of the link; arpd's Fast DDS profile has settings for it
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._held_until_s = -math.inf
        self._make()

    def publish(self, chunk: bytes) -> None:
        """Write a chunk."""
        self._outlet.publish(chunk)

    def follow(self, held_until_s: float) -> None:
        """Forget what has not arrived, once freight is held; until when that is (s)."""
        if held_until_s > self._held_until_s:
            self._held_until_s, before = held_until_s, self._publisher
            self._make()
            self._node.destroy_publisher(before)
            log.warning("the link loses datagrams of several packets; large samples cross in packets for a while")

    def _make(self) -> None:
        qos = QoSProfile(depth=LINK_DEPTH)
        self._publisher = self._node.create_publisher(UInt8MultiArray, self._topic, qos, event_callbacks=NO_EVENTS)
        self._outlet = Outlet(self._publisher.handle)


class LinkReader(RawReader):
    """Puts the messages of one topic, or of several, of the other end together.

    Parameters
    ----------
    node, topic : in the domain of the link
    deliver : called in the thread with each message, its last chunk, and the age of that (s); ValueError = no such
        message. It must not wait: the receipts of all chunks would come late, as if the link was out
    how : of its chunks, as `LinkQueue.arrived` takes it
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        link: LinkThread,
        thread: ReadingThread,
        deliver: Callable[[bytes, Chunk, float], None],
        **how: bool,
    ) -> None:
        self._account, self._pass_on, self._how = link, deliver, how
        self._assembly = Assembly()
        self._logged = OncePerMinute()
        super().__init__(node, UInt8MultiArray, topic, LINK_QOS, deliver=self._take, thread=thread)

    def _take(self, sample: Sample) -> None:
        try:
            chunk, age_s = self._account.arrived(sample.data, **self._how)
            if (message := self._assembly.add(chunk)) is not None:
                self._pass_on(message, chunk, age_s)
        except ValueError as fault:
            if self._logged.take("", time.monotonic()):
                log.warning("ignored a message of %s: %s (logged once a minute)", self.name, fault)
