"""Topics on the link: their writers there, what the daemon sees and plans of them, and who reads them."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.lane import Lane
from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.endpoints import Direction, PublisherState, WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.outgoing import Carried, Outgoing
from arpd.relay.envelope import Record, pack
from arpd.relay.sets import Sets
from arpd.ros.graph import type_name_of
from arpd.ros.graph_view import GraphView
from arpd.ros.rcl import no_publisher_events, rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.model.price import Price
    from arpd.relay.ends.link import LinkThread
    from arpd.relay.ends.offers import TopicOffer, WriterOffer
    from arpd.relay.ends.survey import Writer
    from arpd.ros.raw_reader import Sample

_HISTORY = 1000  # most small samples of a latched writer; of its large ones, a map for example, the newest
_LINGER_S = 3.0  # an end that has just started wants nothing at first
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
    depth : most samples that wait before the first plan
    members : topics of a group, in their order: its samples cross in sets; empty = it is no group
    lane : arguments of its `Lane`
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        thread: LinkThread,
        depth: int,
        members: Collection[str],
        lane: Mapping[str, Any],
        clock: Callable[[], float],
    ) -> None:
        self._members = {member: place for place, member in enumerate(members)}
        self.sets = Sets(()) if members else None
        self._lock = threading.Lock()  # guards the sets: who learns the name of a writer sends, too
        self._node, self._thread, self._clock = node, thread, clock
        self._publisher = node.create_publisher(
            UInt8MultiArray, topic, QoSProfile(depth=LINK_DEPTH), event_callbacks=no_publisher_events()
        )
        self.topic_name = str(self._publisher.topic_name)
        self._lane = Lane(rcl().outlet(self._publisher.handle).publish, **lane)
        self._price: Price | None = None
        self.baseline = WriterQos(depth=depth, deadline_ns=0)
        self.plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=depth)
        thread.add(self._lane)
        self._shared = NodePublishers.of(node)
        self._shared.adopt(self)

    def send(self, topic: str, writer: Writer, sample: Sample) -> None:
        """Let a sample wait for its turn; of a group, its set once that is complete."""
        record = Record(writer.key, sample.sequence, sample.data)
        lifespan_ns = writer.offer.lifespan_ns
        if self.sets is None:
            self._thread.offer(self._lane, pack([record]), source=writer.key, lifespan_ns=lifespan_ns)
            return
        with self._lock:
            complete = self.sets.add(self._members[topic], record)
        if complete is not None:
            self._thread.offer(self._lane, pack(complete), lifespan_ns=lifespan_ns)

    def follow(self, topics: Collection[str]) -> None:
        """Wait for the samples of these topics of the group."""
        if self.sets is not None:
            with self._lock:
                self.sets.members = frozenset(self._members[topic] for topic in topics)

    def get_subscription_count(self) -> int:
        """Count the matched readers."""
        return int(self._publisher.get_subscription_count())

    def destroy(self) -> None:
        """Destroy the writer; what waits is lost."""
        self._shared.release(self)
        self._thread.remove(self._lane)
        self._node.destroy_publisher(self._publisher)

    # -- what `NodePublishers` calls

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan, which is in force at once."""
        if plan != self.plan:
            self.plan = plan
            self._thread.retune(self._lane, plan, self._price)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is there."""
        if price != self._price:
            self._price = price
            self._thread.retune(self._lane, self.plan, price)

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


class LinkOutgoing(Outgoing[LinkTopic]):
    """Offers the samples of the wanted topics to the paced queue of the link.

    A topic is read once its writer on the link has a reader there: a history would be lost otherwise.

    Parameters
    ----------
    link_node : the end's node in the domain of the link
    link : writes to the link
    others : as `Outgoing` takes them
    """

    def __init__(self, link_node: Node, link: LinkThread, **others: Any) -> None:
        super().__init__(linger_s=_LINGER_S, **others)
        self._link_node, self._link = link_node, link
        self._view = GraphView.of(link_node)
        self._readers_gids = ""
        self._incomplete = 0  # of groups that are not carried any more

    @property
    def plans(self) -> dict[str, tuple[int, int]]:
        """DEPTH and DEADLINE that the daemon has planned (samples, ns), by the name on the link."""
        plans = {name: carried.publisher.plan for name, carried in self._carried.items()}
        return {name: plan.qos for name, plan in plans.items() if plan.weight > 0}

    @property
    def incomplete(self) -> int:
        """Count the samples of groups whose set was never complete."""
        sets = [carried.publisher.sets for carried in self._carried.values()]
        return self._incomplete + sum(each.dropped for each in sets if each is not None)

    def living(self, topic: str, writers: Iterable[WriterOffer]) -> tuple[WriterOffer, ...]:
        """Return the writers of a topic in a lasting order, each with whether it is alive."""
        carried = self._carried.get(self.link_name(topic))
        readers = None if carried is None else carried.readers.get(topic)
        return tuple(
            replace(writer, is_alive=readers is not None and readers.are_alive(writer)) if writer.is_manual else writer
            for writer in sorted(writers, key=lambda writer: writer.gid)
        )

    def step(self, offers: Mapping[str, TopicOffer]) -> None:
        """Open the readers of topics whose writer on the link has found its reader there."""
        super().step(offers)
        for carried in self._carried.values():
            carried.publisher.follow(carried.wanted - self.refused.keys())

    def meet(self, link_gids: str) -> None:
        """Begin again with latched topics: the other end is another process now, and lacks their histories.

        They are read once a reader of that process has matched: for some seconds those of the dead one still do.

        The other topics stay as they are, because the new process may hear them already: it asks for what it reads a
        second after its start, and new writers would cost it the samples of their match.

        Parameters
        ----------
        link_gids : first bytes of the GUIDs of its endpoints on the link, in hexadecimal digits; empty = not known
        """
        self._readers_gids = link_gids
        self.forget([name for name, carried in self._carried.items() if carried.is_latched])

    def _is_heard(self, publisher: LinkTopic) -> bool:
        """Return whether the other end's process reads it, and not only the one before."""
        if not publisher.get_subscription_count():
            return False
        self._view.look()
        return any(
            reader.gid.hex().startswith(self._readers_gids) for reader in self._view.readers(publisher.topic_name)
        )

    def _publisher(self, link_name: str, _type_name: str, *, is_latched: bool) -> LinkTopic:
        asked = self._settings.depths.get(link_name)
        depth = asked or DEFAULT_RELAY_DEPTH
        members = next((group.topics for group in self._settings.groups if group.name == link_name), ())
        lane: dict[str, Any] = {"has_company": not members}  # a set of a group leaves alone: it is seldom small
        if link_name in self._settings.queued:
            lane = {"depth": depth, "large_depth": depth, "is_ordered": True, "is_kept": True}
        elif is_latched:
            lane = {"depth": asked or _HISTORY, "large_depth": asked or 1, "is_kept": True}
        return LinkTopic(
            self._link_node,
            link_name,
            thread=self._link,
            depth=depth,
            members=members,
            lane=lane,
            clock=self._clock,
        )

    def _check(self, carried: Carried[LinkTopic], kind: Any) -> None:
        first = next(iter(kind.get_fields_and_field_types().values()), "")
        if carried.publisher.sets is not None and first != "std_msgs/Header":
            raise ValueError(f"{type_name_of(kind)} has no header stamp, by which its group is thinned")

    def _drop(self, link_name: str) -> None:
        sets = self._carried[link_name].publisher.sets
        super()._drop(link_name)
        self._incomplete += 0 if sets is None else sets.dropped
