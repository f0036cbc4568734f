"""The link as an end uses it: one thread that writes everything, the topics there, and who puts messages together."""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.node_publishers import NodePublishers
from arpd.endpoint.writing_thread import WritingThread
from arpd.model.endpoints import Direction, PublisherState, WithheldCause, WriterQos
from arpd.model.quantities import format_size
from arpd.model.settings import DEFAULT_RELAY_DEPTH, RelaySettings
from arpd.relay.ends.outgoing import Carried
from arpd.relay.envelope import MOST_MESSAGE_BYTES, Assembly, Chunk, Record, pack, writer_key
from arpd.relay.link_queue import LinkQueue
from arpd.relay.sets import Sets
from arpd.ros.cdr import wrap
from arpd.ros.graph import GraphView, type_name_of
from arpd.ros.names import on_link
from arpd.ros.rate_limits import OncePerMinute
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample, is_late
from arpd.ros.rcl import NO_EVENTS, Outlet

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rclpy.node import Node

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price
    from arpd.relay.ends.offers import WriterOffer

log = logging.getLogger(__name__)
#: Reliable. The thread takes samples at once, so this bridges its scheduling only; and calls repeat themselves.
LINK_QOS = QoSProfile(depth=1000)
STATE_QOS = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
_SIGN_QOS = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
#: Chunks that DDS keeps until they are acknowledged: more than may be on their way (`Flight`).
LINK_DEPTH = 400
_HISTORY = 1000  # most small samples of a latched writer; of its large ones, a map for example, the newest
_LATE_S = 0.1  # the thread that reads waits for the processor: a scheduler takes less


class LinkThread(WritingThread):
    """Writes to the link, and accounts for what arrives from it; nobody else waits for a write.

    Parameters
    ----------
    node, name : in the domain of the link, and what the names of the end's topics there begin with

    Attributes
    ----------
    queue : what waits, and the account of what is on its way
    freight : writes chunks in datagrams
    partner_gids : first bytes of the GUIDs of the other end's readers, in hexadecimal digits; empty = not known
    """

    def __init__(self, session: int, node: Node, name: str) -> None:
        def writes(ending: str, qos: QoSProfile) -> Callable[[bytes], None]:
            publisher = node.create_publisher(UInt8MultiArray, name + ending, qos, event_callbacks=NO_EVENTS)
            return Outlet(publisher.handle).publish

        self.freight = FreightWriter(node, f"{name}/large")
        self.queue = LinkQueue(
            session,
            time.monotonic(),
            together=writes("/small", LINK_QOS),
            freight=self.freight.publish,
            asleep_s=lambda: lasting_s() - time.monotonic(),
        )
        super().__init__(self.queue, name="arpd-link", warn=log.error)
        self._write_state, self._write_sign = writes("", STATE_QOS), writes("/alive", _SIGN_QOS)
        # Two topics of weight 1 in the paced queue, of which none is dropped: a cancel waits behind no map.
        write = writes("/calls", LINK_QOS)
        self._small_calls, self._large_calls = Lane(write, is_kept=True), Lane(write, is_kept=True)
        self.add(self._small_calls)
        self.add(self._large_calls)
        self.partner_gids = ""
        self._state: bytes | None = None  # that waits; a newer one takes its place

    def send_call(self, record: bytes, source: int) -> None:
        """Let a record wait for its turn, in the place of one of this source; a large one on its way is not repeated.

        Calls repeat themselves once a second, and a large answer takes longer. A small record overtakes no large one of
        its source, which it may take back.
        """
        with self._changed:
            is_large, is_there = len(record) > SMALL_BYTES, self._large_calls.has(source, self._clock())
            if not (is_large and is_there):
                self.offer(self._large_calls if is_large or is_there else self._small_calls, record, source=source)

    def miss(self, lane: Lane, samples: int) -> None:
        """Count samples that nobody had time to read as offered and withheld."""
        with self._changed:
            lane.offered_rate.samples += samples
            lane.withheld[WithheldCause.BLOCKED.value] += samples

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
        return super()._choose(now_s)

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
        self._logged = OncePerMinute()
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
            message = pack(records)
            if len(message) > MOST_MESSAGE_BYTES and self._logged.take("", time.monotonic()):
                sizes = format_size(len(message)), format_size(MOST_MESSAGE_BYTES)
                log.error("%s has samples of %s, and none above %s crosses (logged once a minute)", topic, *sizes)
            self._thread.offer(self._lane, message, source=source, lifespan_ns=writer.lifespan_ns)

    def miss(self, samples: int) -> None:
        """Count what this computer lost before the next sample; of a group nobody counts it."""
        if self._sets is None:
            self._thread.miss(self._lane, samples)

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
        return PublisherState(
            node=self._node.get_fully_qualified_name(),
            topic=self.topic_name,
            type_name=type_name_of(UInt8MultiArray),
            direction=Direction.LOCAL,
            baseline_depth=self.baseline.depth,
            **self._lane.state(time.monotonic()).counted(),
        )
