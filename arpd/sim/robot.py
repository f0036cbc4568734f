"""A robot in virtual time: topics, sources, and publishers with arpd's own pacing and writer swap."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.endpoint.flow import Flow
from arpd.endpoint.queue import PacedQueue
from arpd.model.endpoints import Direction, FlowState, Overflow, PublisherState, WriterQos
from arpd.sim.result import SAMPLE, Arrivals, SimTopic, TopicResult
from arpd.sim.socket import Carrier, Socket
from arpd.sim.timeline import Alarm, Timeline
from arpd.sim.writer import SimulatedWriter
from arpd.solve.topics import assumed_traffic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from random import Random

    from arpd.endpoint.lane import Lane
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price
    from arpd.model.settings import Settings

RCLPY_DEPTH = 10  # the depth in every rclpy tutorial


def configured_topics(settings: Settings, *, actuation: Collection[str]) -> tuple[SimTopic, ...]:
    """Return the topics whose traffic a configuration describes.

    Parameters
    ----------
    settings : the configuration
    actuation : names of the actuation topics, which the configuration does not tell
    """
    prefix = settings.relay.link_prefix
    relayed = {prefix + name: name for name in settings.relay.topic_names}
    return tuple(
        SimTopic(
            name=relayed.get(each.topic, each.topic),
            payload_bytes=max(1, round(each.payload_bytes)),
            rate_hz=each.source_rate_hz,
            direction=Direction.ACTUATION if each.topic in actuation else Direction.SENSING,
            prefix=prefix if each.topic in relayed else "",
        )
        for each in assumed_traffic(settings)
        if each.source_rate_hz > 0
    )


class SimulatedThread:
    """The thread of a participant, with its paced queue."""

    def __init__(self, timeline: Timeline, queue: PacedQueue | None = None) -> None:
        self.timeline = timeline
        self.queue = PacedQueue() if queue is None else queue
        self._alarm = Alarm(timeline, self.run)

    def add(self, lane: Lane) -> None:
        """Serve a lane from now on."""
        self.queue.add(lane)

    def offer(self, lane: Lane, sample: bytes) -> None:
        """Let a sample wait for its turn, which may be now."""
        self.queue.offer(lane, sample, self.timeline.now_s)
        self.run()

    def retune(self, lane: Lane, plan: TopicPlan, price: Price | None) -> None:
        """Give a lane its plan and the price; None = no daemon is there."""
        self.queue.retune(lane, plan, price)
        self.run()

    def run(self) -> None:
        """Write what may leave."""
        now_s = self.timeline.now_s
        while (ready := self.queue.take(now_s)) is not None:
            ready.lane.write(ready.sample)
        self._alarm.set_by(self.queue.due_s(now_s))


class SimulatedSource:
    """What the application publishes on one topic, and what arrives of it.

    Parameters
    ----------
    topic : the topic
    node : of its publisher
    ingress_s : age of a sample when it gets to the publisher, after the hop to the relay (s)

    Attributes
    ----------
    name : of the topic on the link
    swaps : writer swaps begun since the start
    """

    def __init__(self, timeline: Timeline, topic: SimTopic, *, node: str, name: str, ingress_s: float) -> None:
        self.timeline, self.topic, self._ingress_s = timeline, topic, ingress_s
        self.arrivals = Arrivals(timeline, topic)
        self.swaps = 0
        self._padding = bytes(max(0, topic.payload_bytes - SAMPLE.size))
        self.name = name
        self._announced = PublisherState(
            node=node,
            topic=name,
            type_name="sim",
            direction=topic.direction,
            payload_bytes=0.0,
            source_rate_hz=0.0,
            depth=RCLPY_DEPTH,
            baseline_depth=RCLPY_DEPTH,
            remote_readers=int(topic.direction is not Direction.LOCAL),
        )

    def sample(self, number: int) -> bytes:
        """Return a sample that is published now."""
        return SAMPLE.pack(number, self.timeline.now_s - self._ingress_s) + self._padding

    def told(self, flow: FlowState) -> PublisherState:
        """Return the state to announce."""
        return replace(self._announced, **flow.counted())


class SimulatedPublisher(SimulatedSource):
    """An AdaptivePublisher over a simulated writer, with the same queue and writer swap.

    Before the first `retune` it behaves as a plain rclpy publisher.

    Parameters
    ----------
    there, back : ways of its samples, and of their acknowledgements
    room_bytes : most that its socket has in the queue of the interface (bytes)
    heartbeat_s : heartbeat period of its writers (s)
    thread : of its participant
    name, node, ingress_s : as of `SimulatedSource`
    """

    def __init__(
        self,
        timeline: Timeline,
        topic: SimTopic,
        *,
        there: Carrier,
        back: Carrier,
        room_bytes: float,
        heartbeat_s: float,
        thread: SimulatedThread,
        name: str,
        node: str,
        ingress_s: float = 0.0,
    ) -> None:
        super().__init__(timeline, topic, node=node, name=name, ingress_s=ingress_s)
        self.swaps = -1  # the first writer is none
        self._socket = Socket(timeline, there, room_bytes=room_bytes, on_free=self._free)
        self._is_relayed = ingress_s > 0.0
        self._ticks = 0  # of the application's timer
        self._flow = Flow(
            create=partial(self._create, back, heartbeat_s),
            qos=WriterQos(depth=RCLPY_DEPTH, deadline_ns=0),
            overflow=Overflow.LATEST,
            clock=lambda: timeline.now_s,
            on_held=self._service,
        )
        self._flow.lane.write = self._write
        self._thread = thread
        thread.add(self._flow.lane)
        self._alarm = Alarm(timeline, self._service)

    def publish(self) -> None:
        """Publish the next sample of the source, unless it is still inside the call before."""
        self._ticks += 1
        if self._socket.is_full and not self._is_relayed:
            return
        self._thread.offer(self._flow.lane, self.sample(self._flow.lane.offered_rate.samples))

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan: pacing changes now, depth and deadline with a writer swap."""
        self._flow.swap.request(WriterQos(depth=plan.depth, deadline_ns=plan.deadline_ns))
        self._thread.retune(self._flow.lane, plan, self._flow.lane.price)
        self._service()

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is heard."""
        self._thread.retune(self._flow.lane, self._flow.lane.plan, price)

    def state(self) -> PublisherState:
        """Return the state to announce."""
        return self.told(self._flow.state())

    def result(self) -> TopicResult:
        """Return the result of the run."""
        return self.arrivals.result(self._flow.state(), expected=self._ticks)

    def _write(self, sample: bytes) -> None:
        self._flow.write(sample)
        if self._socket.is_full:
            self._flow.lane.claimant = 1  # the thread is inside the call

    def _free(self) -> None:
        self._flow.lane.claimant = None
        self._service()
        self._thread.run()

    def _create(self, back: Carrier, heartbeat_s: float, qos: WriterQos) -> SimulatedWriter:
        self.swaps += 1
        take = self.arrivals
        return SimulatedWriter(
            self._socket, back, take.on_delivery, arrive=take.on_arrival, qos=qos, heartbeat_s=heartbeat_s
        )

    def _service(self) -> None:
        if not self._socket.is_full:
            self._alarm.set_by(self._flow.service(self.timeline.now_s))


def play_source(
    timeline: Timeline, publish: Callable[[], None], *, rate_hz: float, end_s: float, random: Random
) -> None:
    """Publish from the start of the run to its end, with the jitter of an executor."""

    def fire(due_s: float) -> None:
        publish()
        due_s += 1.0 / rate_hz
        if due_s < end_s:
            timeline.at(due_s + min(0.002, random.expovariate(2000.0)), partial(fire, due_s))

    phase_s = random.random() / rate_hz
    timeline.at(phase_s, partial(fire, phase_s))
