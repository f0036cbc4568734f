"""A relay's two ends in virtual time, with arpd's own queue, chunks and receipts."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING

from arpd.endpoint.lane import Lane
from arpd.model.endpoints import PublisherState, WriterQos
from arpd.model.wire import LINK_HEARTBEAT_S, wire_size
from arpd.relay.envelope import Assembly, Chunk, Record, pack, unpack, writer_key
from arpd.relay.flight import SIGN_BYTES
from arpd.relay.link_queue import LinkQueue
from arpd.sim.robot import RCLPY_DEPTH, SimulatedSource, SimulatedThread
from arpd.sim.socket import Carrier, Socket
from arpd.sim.writer import SimulatedWriter

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price
    from arpd.sim.result import SimTopic, TopicResult
    from arpd.sim.timeline import Timeline

_LINK_QOS = WriterQos(depth=400, deadline_ns=0)  # as arpd.relay.ends.link


class SimulatedEnd(SimulatedThread):
    """One end: its thread writes what its queue lets onto the link, and its signs of life.

    Parameters
    ----------
    there, back : ways to the other end, and from it
    session : of its process
    """

    queue: LinkQueue

    def __init__(self, timeline: Timeline, *, there: Carrier, back: Carrier, session: int) -> None:
        self._there, self.back = there, back
        # Its participant waits for no write: what a full socket does not take is sent again.
        self.socket = Socket(timeline, there, room_bytes=math.inf)
        writer = partial(SimulatedWriter, self.socket, back, qos=_LINK_QOS, heartbeat_s=LINK_HEARTBEAT_S)
        small, large = writer(self._on_small), writer(self._on_large, is_freight=True)
        queue = LinkQueue(session, timeline.now_s, together=small.publish, freight=large.publish)
        super().__init__(timeline, queue)
        self._assembly = Assembly()  # of freight, at the other end
        self._writers: dict[bytes, Callable[[Record], None]] = {}  # what takes a writer's samples at the other end
        self.other: SimulatedEnd = self

    def start(self, other: SimulatedEnd) -> None:
        """Begin to speak with the other end."""
        self.other = other
        self.run()

    def take(self, writer: bytes, deliver: Callable[[Record], None]) -> None:
        """Let a function take a writer's small samples at the other end."""
        self._writers[writer] = deliver

    def arrived(self, sample: bytes, **how: bool) -> Chunk:
        """Account for a chunk of the other end."""
        chunk, _ = self.queue.arrived(sample, self.timeline.now_s, **how)
        self.run()
        return chunk

    def _on_small(self, sample: bytes) -> None:
        """Deliver small messages that left together."""
        self._deliver(self.other.arrived(sample, is_together=True).part)

    def _on_large(self, sample: bytes) -> None:
        message = self._assembly.add(self.other.arrived(sample, is_freight=True))
        self._deliver(message or b"")

    def _deliver(self, message: bytes) -> None:
        for record in unpack(message):
            self._writers[record.writer](record)

    def hear(self, sign: bytes) -> None:
        """Take a sign of life of the other end."""
        self.queue.follow(self.queue.hear(sign, self.timeline.now_s), self.timeline.now_s)
        self.run()

    def run(self) -> None:
        """Write what may leave, signs of life first."""
        now_s = self.timeline.now_s
        while True:
            if (sign := self.queue.take_sign(now_s)) is not None:
                wire_bytes, packets = wire_size(16 + SIGN_BYTES, rate_hz=math.inf)
                self._there.send(wire_bytes, packets, partial(self.other.hear, sign))
            elif (ready := self.queue.take(now_s)) is not None:
                ready.lane.write(ready.sample)
            else:
                break
        self._alarm.set_by(min(self.queue.sign_s, self.queue.due_s(now_s)))


class SimulatedLinkTopic(SimulatedSource):
    """One topic that the two ends carry; its writer on the link is never replaced.

    Parameters
    ----------
    end : the end that sends it
    topic, node, ingress_s : as of `SimulatedSource`
    """

    def __init__(self, topic: SimTopic, *, end: SimulatedEnd, node: str, ingress_s: float) -> None:
        super().__init__(end.timeline, topic, node=node, name=topic.name, ingress_s=ingress_s)
        self._end = end
        self._numbers = count()
        self._assembly = Assembly()
        writer = SimulatedWriter(end.socket, end.back, self._on_chunk, qos=_LINK_QOS, heartbeat_s=LINK_HEARTBEAT_S)
        self._key = writer_key(topic.name)
        self._lane = Lane(writer.publish, has_company=True)
        self._lane.plan = replace(self._lane.plan, depth=RCLPY_DEPTH)
        end.add(self._lane)
        end.take(self._key, self._deliver)

    def publish(self) -> None:
        """Publish the next sample of the source."""
        number = next(self._numbers)
        self._end.offer(self._lane, pack([Record(self._key, number + 1, self.sample(number))]))

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan, which is in force at once."""
        self._end.retune(self._lane, plan, self._lane.price)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is heard."""
        self._end.retune(self._lane, self._lane.plan, price)

    def state(self) -> PublisherState:
        """Return the state to announce."""
        return self.told(self._lane.state(self.timeline.now_s))

    def result(self) -> TopicResult:
        """Return the result of the run."""
        flow = self._lane.state(self.timeline.now_s)
        return self.arrivals.result(flow, expected=flow.offered)

    def _on_chunk(self, sample: bytes) -> None:
        """Put a chunk to its message at the other end; the ghost there publishes what is whole."""
        if (message := self._assembly.add(self._end.other.arrived(sample))) is not None:
            for record in unpack(message):
                self._deliver(record)

    def _deliver(self, record: Record) -> None:
        self.arrivals.on_arrival(record.sample)
        self.arrivals.on_delivery(record.sample)
