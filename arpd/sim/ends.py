"""A relay's two ends in virtual time, with arpd's own queue, chunks and receipts."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING

from arpd.endpoint.lane import Lane
from arpd.model.endpoints import WriterQos
from arpd.model.plan import TopicPlan
from arpd.model.wire import LINK_HEARTBEAT_S, wire_size
from arpd.relay.envelope import Assembly, Record, pack, unpack, writer_key
from arpd.relay.flight import SIGN_BYTES
from arpd.relay.link_queue import LinkQueue
from arpd.sim.result import Arrivals
from arpd.sim.socket import Socket
from arpd.sim.timeline import Alarm
from arpd.sim.writer import SAMPLE, Counting, SimulatedWriter

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.endpoints import PublisherState
    from arpd.model.price import Price
    from arpd.relay.envelope import Chunk
    from arpd.sim.result import TopicResult
    from arpd.sim.robot import SimTopic
    from arpd.sim.socket import Carrier
    from arpd.sim.timeline import Timeline

_LINK_QOS = WriterQos(depth=400, deadline_ns=0)  # as arpd.relay.ends.link_topic
_DEPTH = 10  # before a plan


class SimulatedEnd:
    """One end: its thread writes what its queue lets onto the link, and its signs of life.

    Parameters
    ----------
    there, back : ways to the other end, and from it
    session : of its process
    """

    def __init__(self, timeline: Timeline, *, there: Carrier, back: Carrier, session: int) -> None:
        self.timeline, self._there, self.back = timeline, there, back
        # Its participant waits for no write: what a full socket does not take is sent again.
        self.socket = Socket(timeline, there, room_bytes=math.inf)
        small = SimulatedWriter(self.socket, back, self, qos=_LINK_QOS, heartbeat_s=LINK_HEARTBEAT_S)
        self._queue = LinkQueue(session, timeline.now_s, together=small.publish)
        self._writers: dict[bytes, Callable[[Record], None]] = {}  # what takes a writer's samples at the other end
        self._alarm = Alarm(timeline, self._run)
        self.other: SimulatedEnd = self

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self._queue.link_bytes

    @property
    def held_s(self) -> float:
        """Time in which something waited for receipts (s)."""
        return self._queue.held_s

    def start(self, other: SimulatedEnd) -> None:
        """Begin to speak with the other end."""
        self.other = other
        self._run()

    def add(self, lane: Lane, writer: bytes, deliver: Callable[[Record], None]) -> None:
        """Serve a lane from now on, whose writer's small samples the function takes at the other end."""
        self._queue.add(lane)
        self._writers[writer] = deliver

    def offer(self, lane: Lane, message: bytes) -> None:
        """Let a message wait for its turn, which may be now."""
        self._queue.offer(lane, message, self.timeline.now_s)
        self._run()

    def retune(self, lane: Lane, plan: TopicPlan, price: Price | None) -> None:
        """Give a lane its plan and the price; None = there is none."""
        self._queue.retune(lane, plan, price)
        self._run()

    def arrived(self, sample: bytes, *, is_together: bool = False) -> Chunk:
        """Account for a chunk of the other end."""
        chunk, _ = self._queue.arrived(sample, self.timeline.now_s, is_together=is_together)
        self._run()
        return chunk

    def on_arrival(self, sample: bytes) -> None:
        """Do nothing: small messages that leave together have a latency each."""

    def on_delivery(self, sample: bytes) -> None:
        """Deliver small messages that left together."""
        for record in unpack(self.other.arrived(sample, is_together=True).part):
            self._writers[record.writer](record)

    def hear(self, sign: bytes) -> None:
        """Take a sign of life of the other end."""
        self._queue.follow(self._queue.hear(sign, self.timeline.now_s), self.timeline.now_s)
        self._run()

    def _run(self) -> None:
        now_s = self.timeline.now_s
        while True:
            if (sign := self._queue.take_sign(now_s)) is not None:
                wire_bytes, packets = wire_size(16 + SIGN_BYTES, rate_hz=math.inf)
                self._there.send(wire_bytes, packets, partial(self.other.hear, sign))
            elif (ready := self._queue.take(now_s)) is not None:
                ready.lane.write(ready.sample)
            else:
                break
        self._queue.note_held(now_s)
        if (due_s := min(self._queue.sign_s, self._queue.due_s(now_s))) < self._alarm.when_s:
            self._alarm.set(due_s)


class SimulatedLinkTopic:
    """One topic that the two ends carry; its writer on the link is never replaced.

    Parameters
    ----------
    topic : the topic
    end : the end that sends it
    node : name of the end's node
    ingress_s : age of a sample when it gets to the end (s)
    """

    def __init__(self, topic: SimTopic, *, end: SimulatedEnd, node: str, ingress_s: float) -> None:
        self.topic, self._end = topic, end
        self.arrivals = Arrivals()
        self.swaps = 0
        self._ingress_s = ingress_s
        self._padding = bytes(max(0, topic.payload_bytes - SAMPLE.size))
        self._numbers = count()
        self._assembly = Assembly()
        self._counting = Counting(self.arrivals, end.timeline, topic.payload_bytes)
        self._writer = SimulatedWriter(end.socket, end.back, self, qos=_LINK_QOS, heartbeat_s=LINK_HEARTBEAT_S)
        self._key = writer_key(topic.name)
        self._lane = Lane(self._writer.publish, has_company=True)
        self._plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=_DEPTH)
        self._price: Price | None = None
        end.add(self._lane, self._key, self._deliver)
        self._state = topic.announced(node=node, name=topic.name, depth=_DEPTH)

    def publish(self) -> None:
        """Publish the next sample of the source."""
        number = next(self._numbers)
        sample = SAMPLE.pack(number, self._end.timeline.now_s - self._ingress_s) + self._padding
        self._end.offer(self._lane, pack([Record(self._key, number + 1, sample)]))

    def retune(self, plan: TopicPlan) -> None:
        """Take a plan, which is in force at once."""
        self._plan = plan
        self._end.retune(self._lane, plan, self._price)

    def set_price(self, price: Price | None) -> None:
        """Take the price of the link; None = no daemon is heard."""
        self._price = price
        self._end.retune(self._lane, self._plan, price)

    def state(self, *, generation: int) -> PublisherState:
        """Return the state to announce."""
        flow = replace(self._lane.state(self._end.timeline.now_s), blocked_s=self._end.held_s, depth=self._plan.depth)
        return replace(self._state, generation=generation, **flow.counted())

    def result(self) -> TopicResult:
        """Return the result of the run."""
        flow = self._lane.state(self._end.timeline.now_s)
        topic = self.topic
        return self.arrivals.result(flow, topic=topic.name, source_rate_hz=topic.rate_hz, expected=flow.offered)

    def on_arrival(self, sample: bytes) -> None:
        """Do nothing: a chunk has no latency of its own."""

    def on_delivery(self, sample: bytes) -> None:
        """Put a chunk to its message at the other end; the ghost there publishes what is whole."""
        if (message := self._assembly.add(self._end.other.arrived(sample))) is not None:
            for record in unpack(message):
                self._deliver(record)

    def _deliver(self, record: Record) -> None:
        self._counting.on_arrival(record.sample)
        self._counting.on_delivery(record.sample)
