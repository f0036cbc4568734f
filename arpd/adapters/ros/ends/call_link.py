"""Calls of services on the link: their records, and what both ends offer, in the thread of the local domain."""

from __future__ import annotations

import logging
import time
from collections import deque
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.ends.calls import Calls
from arpd.adapters.ros.ends.raw_reader import RawReader, ReadingThread, Sample
from arpd.adapters.ros.events import no_publisher_events
from arpd.adapters.ros.rcl import rcl
from arpd.apply.endpoint.lane import SMALL_BYTES, Lane
from arpd.apply.relay.call_records import what_of
from arpd.apply.relay.envelope import Assembly
from arpd.observe.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

    from arpd.adapters.ros.ends.ghosts import GhostNodes
    from arpd.adapters.ros.ends.link_thread import LinkThread
    from arpd.apply.relay.offers import ServiceOffer

log = logging.getLogger(__name__)
_TICK_S = 0.02  # between bursts of requests to a server, and of answers to a client
_LOOK_S = 0.5
_QOS = QoSProfile(depth=1000)  # reliable; calls repeat themselves, so an overflow costs time only
_OWNER = "services"
_MOST_RECORDS = 1000  # that wait for a tick; a call whose record is dropped repeats it


class CallLink:
    """Carries the calls of one end, as a topic of weight 1 in the paced queue whose records are never dropped.

    Parameters
    ----------
    node, link_node : the end's nodes in the local domain and in that of the link
    nodes : ghosts of the other side's nodes
    thread : takes the records
    link : writes to the link
    own, other : topics of this end's records and of the other's
    is_used : whether anything may be called
    allows, timeout_s, session, namespace : as in `Calls`
    local_name : returns the local name of a node of the other side
    """

    def __init__(
        self,
        node: Node,
        link_node: Node,
        *,
        nodes: GhostNodes,
        thread: ReadingThread,
        link: LinkThread,
        own: str,
        other: str,
        is_used: bool,
        allows: Callable[[str], bool],
        timeout_s: float,
        session: str,
        namespace: str,
        local_name: Callable[[str], str],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._nodes = nodes
        self._local_name = local_name
        self._clock = clock
        self._node = node
        self._records: deque[bytes] = deque(maxlen=_MOST_RECORDS)
        self._is_woken = False
        self._logged = OncePerMinute()
        self._calls = Calls(
            node,
            send=self._send,
            ghost_node=partial(nodes.served, owner=_OWNER),
            allows=allows,
            timeout_s=timeout_s,
            session=session,
            namespace=namespace,
            clock=clock,
        )
        self._link = link
        self._lane: Lane | None = None
        self._assembly = Assembly()
        self._reader: RawReader | None = None
        self._look_s = clock()
        self.offers: Mapping[str, ServiceOffer] = MappingProxyType({})
        self.refused: Mapping[str, str] = MappingProxyType({})
        self.failures: Mapping[str, int] = MappingProxyType({})
        # Services that the other end offers, and its session, None = unreachable; the end's own thread sets it.
        self.offered: tuple[Mapping[str, ServiceOffer], str | None] = MappingProxyType({}), None
        if is_used:
            publisher = link_node.create_publisher(UInt8MultiArray, own, _QOS, event_callbacks=no_publisher_events())
            self._lane = Lane(rcl().outlet(publisher.handle).publish, is_kept=True)
            link.add(self._lane)
            self._reader = RawReader(link_node, UInt8MultiArray, other, _QOS, deliver=self._arrive, thread=thread)
            node.create_timer(_TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Destroy everything."""
        if self._reader is not None:
            self._reader.destroy()
            self._calls.destroy()

    def _take(self) -> None:
        self._is_woken = False
        while self._records:
            self._calls.receive(self._records.popleft())

    def _tick(self) -> None:
        now_s = self._clock()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            self.offers = self._calls.offers()
            offered, session = self.offered
            self._calls.follow(offered, session=session)
            self._nodes.release(_OWNER, {self._local_name(offer.node) for offer in offered.values()})
            self.refused, self.failures = dict(self._calls.refused), dict(self._calls.failures)
        self._take()
        self._calls.step(now_s)

    def _arrive(self, sample: Sample) -> None:
        try:
            chunk, _ = self._link.arrived(sample.data)
        except ValueError as fault:
            if self._logged.take("chunk", self._clock()):
                log.warning("a record of the other end was ignored: %s (logged once a minute)", fault)
            return
        if (record := self._assembly.add(chunk)) is not None:
            self._records.append(record)
            # EventsExecutor has no guard conditions, but both executors wake for a task.
            if not self._is_woken and (executor := self._node.executor) is not None:
                self._is_woken = True
                executor.create_task(self._take)

    def _send(self, record: bytes) -> None:
        if self._lane is None:
            return
        # A call repeats itself once a second; a large answer takes longer.
        source = what_of(record)
        if len(record) <= SMALL_BYTES or not self._link.is_sending(self._lane, source):
            self._link.offer(self._lane, record, source=source)
