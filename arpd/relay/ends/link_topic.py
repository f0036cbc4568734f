"""One topic on the link: its writer there, and what the daemon sees and plans of it."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.endpoints import Direction, PublisherState, WriterQos
from arpd.model.plan import TopicPlan
from arpd.ros.events import no_publisher_events
from arpd.ros.graph import type_name_of
from arpd.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rclpy.node import Node

    from arpd.endpoint.lane import Lane
    from arpd.model.price import Price
    from arpd.relay.ends.link_thread import LinkThread

#: Chunks that DDS keeps until they are acknowledged: more than may be on their way (`Flight`).
LINK_DEPTH = 400


class LinkTopic:
    """Sends one topic through the paced queue, and follows the daemon's plan and price.

    Its writer is never replaced: the plan's DEPTH bounds what waits in the queue.

    Parameters
    ----------
    node : the end's node in the domain of the link
    topic : its name there
    thread : writes to the link
    make_lane : makes its lane, given what writes a chunk
    depth : most samples that wait before the first plan
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        thread: LinkThread,
        make_lane: Callable[[Callable[[bytes], None]], Lane],
        depth: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._thread = thread
        self._clock = clock
        self._publisher = node.create_publisher(
            UInt8MultiArray, topic, QoSProfile(depth=LINK_DEPTH), event_callbacks=no_publisher_events()
        )
        self.topic_name = str(self._publisher.topic_name)
        self._lane = make_lane(rcl().outlet(self._publisher.handle).publish)
        self._price: Price | None = None
        self.baseline = WriterQos(depth=depth, deadline_ns=0)
        self.plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=depth)
        thread.add(self._lane)
        self._shared = NodePublishers.of(node)
        self._shared.adopt(self)

    @property
    def payload_bytes(self) -> float:
        """Mean size of a sample (bytes)."""
        return self._lane.payload_bytes

    def offer(self, message: bytes, *, source: Hashable = None, lifespan_ns: int = 0) -> None:
        """Let a message wait for its turn; `LinkThread.offer` explains the arguments."""
        self._thread.offer(self._lane, message, source=source, lifespan_ns=lifespan_ns)

    def get_subscription_count(self) -> int:
        """Count the matched readers."""
        return int(self._publisher.get_subscription_count())

    def destroy(self) -> None:
        """Destroy the writer; what waits is lost."""
        self._shared.release(self)
        self._thread.remove(self._lane)
        self._node.destroy_publisher(self._publisher)

    # -- what `NodePublishers` calls

    @property
    def has_refused(self) -> bool:
        """It takes every plan."""
        return False

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan, which is in force at once."""
        self.plan = plan
        self._settle()

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""
        if price != self._price:
            self._price = price
            self._settle()

    def state(self) -> PublisherState:
        """Return the settings in force and the counters, for the daemon."""
        flow = replace(self._lane.state(self._clock()), blocked_s=self._thread.held_s)
        return PublisherState(
            node=self._node.get_fully_qualified_name(),
            topic=self.topic_name,
            type_name=type_name_of(UInt8MultiArray),
            direction=Direction.LOCAL,
            baseline_depth=self.baseline.depth,
            **flow.counted(),
        )

    def _settle(self) -> None:
        self._thread.retune(self._lane, self.plan, self._price)
