"""Topics on the link: their writers there, what the daemon sees and plans of them, and who reads them."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.lane import Lane
from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.endpoints import Direction, PublisherState, WriterQos
from arpd.model.settings import DEFAULT_RELAY_DEPTH, RelaySettings
from arpd.relay.ends.link import LINK_DEPTH
from arpd.relay.ends.outgoing import Carried
from arpd.relay.envelope import Record, pack, writer_key
from arpd.relay.sets import Sets
from arpd.ros.graph import GraphView, type_name_of
from arpd.ros.names import on_link
from arpd.ros.raw_reader import Sample, is_late
from arpd.ros.rcl import NO_EVENTS, Outlet

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rclpy.node import Node

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price
    from arpd.relay.ends.link import LinkThread
    from arpd.relay.ends.offers import WriterOffer

_HISTORY = 1000  # most small samples of a latched writer; of its large ones, a map for example, the newest
_LATE_S = 0.1  # the thread that reads waits for the processor: a scheduler takes less


class LinkTopic(Carried):
    """Sends one topic, or one group, through the paced queue, and follows the daemon's plan and price.

    Its writer is never replaced: the plan's DEPTH bounds what waits in the queue. Samples of a group cross in sets.

    Parameters
    ----------
    node, topic : in the domain of the link
    is_latched : whether a writer is
    on_drop : called with the number of samples of a set that was never complete
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        is_latched: bool,
        thread: LinkThread,
        settings: RelaySettings,
        on_drop: Callable[[int], None],
    ) -> None:
        super().__init__(is_latched=is_latched)
        members = next((group.topics for group in settings.groups if group.name == topic), ())
        self._members = {member: place for place, member in enumerate(members)}
        self._sets = Sets((), on_drop=on_drop) if members else None
        self._lock = threading.Lock()  # guards the sets: who learns the name of a writer sends, too
        self._node, self._thread = node, thread
        self._view = GraphView.of(node)
        self._publisher = node.create_publisher(
            UInt8MultiArray, on_link(topic), QoSProfile(depth=LINK_DEPTH), event_callbacks=NO_EVENTS
        )
        self.topic_name = topic
        asked = settings.depths.get(topic)
        depth = asked or DEFAULT_RELAY_DEPTH
        lane: dict[str, Any] = {"has_company": not members}  # a set of a group leaves alone: it is seldom small
        if topic in settings.queued:
            lane = {"depth": depth, "large_depth": depth, "is_ordered": True, "is_kept": True}
            lane["least_depth"] = asked or 1  # the operator's, however few the plan allows
        elif is_latched:
            lane = {"depth": asked or _HISTORY, "large_depth": asked or 1, "is_kept": True}
        self._lane = Lane(Outlet(self._publisher.handle).publish, **lane)
        self.baseline = WriterQos(depth=depth, deadline_ns=0)
        self._lane.plan = replace(self._lane.plan, depth=depth)
        thread.add(self._lane)
        self._shared = NodePublishers.of(node)
        self._shared.adopt(self)

    def is_heard(self) -> bool:
        """Return whether the other end's process reads it, and not only the one before.

        For some seconds those of a dead process still match.
        """
        if not self._publisher.get_subscription_count():
            return False
        self._view.look()
        readers = self._view.readers(on_link(self.topic_name))
        return any(reader.gid.hex().startswith(self._thread.partner_gids) for reader in readers)

    def check(self, kind: Any) -> None:
        """Raise ValueError where samples of this message class cannot be sent on."""
        first = next(iter(kind.get_fields_and_field_types().values()), "")
        if self._sets is not None and first != "std_msgs/Header":
            raise ValueError(f"{type_name_of(kind)} has no header stamp, by which its group is thinned")

    def expect(self, topics: Collection[str]) -> None:
        """Wait for the samples of these topics of the group."""
        if self._sets is not None:
            with self._lock:
                self._sets.members = frozenset(self._members[topic] for topic in topics)

    def send(self, topic: str, writer: WriterOffer, sample: Sample) -> None:
        """Let a sample wait for its turn; of a group, its set once that is complete."""
        if is_late(sample, _LATE_S):
            self._thread.make_way()
        record = Record(writer_key(writer.gid), sample.sequence, sample.data)
        source, records = record.writer, [record]
        if self._sets is not None:
            with self._lock:
                source, records = b"", self._sets.add(self._members[topic], record)
        if records:
            self._thread.offer(self._lane, pack(records), source=source, lifespan_ns=writer.lifespan_ns)

    def destroy(self) -> None:
        """Destroy the writer; what waits is lost."""
        self._shared.release(self)
        self._thread.remove(self._lane)
        self._node.destroy_publisher(self._publisher)

    # -- what `NodePublishers` calls

    @property
    def plan(self) -> TopicPlan:
        """Settings in force."""
        return self._lane.plan

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan, which is in force at once."""
        if plan != self.plan:
            self.planned = plan.qos if plan.weight > 0 else (0, 0)
            self._thread.retune(self._lane, plan, self._lane.price)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""
        if price != self._lane.price:
            self._thread.retune(self._lane, self.plan, price)

    def finish(self) -> None:
        """Leave what waits: the other end hears no more of this session."""

    def state(self) -> PublisherState:
        """Return the settings in force and the counters, for the daemon."""
        flow = self._lane.state(time.monotonic()).counted()
        return PublisherState(
            node=self._node.get_fully_qualified_name(),
            topic=self.topic_name,
            type_name=type_name_of(UInt8MultiArray),
            direction=Direction.LOCAL,
            baseline_depth=self.baseline.depth,
            **{**flow, "blocked_s": self._thread.queue.held_s},
        )
