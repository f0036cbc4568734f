"""A robot in virtual time: its topics, their sources, and publishers with arpd's own pacing and swap."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.adapters.sim.arrivals import Arrivals
from arpd.adapters.sim.result import TopicResult
from arpd.adapters.sim.timeline import Alarm
from arpd.adapters.sim.writer import SAMPLE, LinkPath, SimulatedWriter
from arpd.apply.endpoint.flow import Flow
from arpd.model.endpoints import Direction, PublisherState, WriterQos
from arpd.model.settings import Overflow
from arpd.solve.topics import assumed_traffic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from random import Random

    from arpd.adapters.sim.timeline import Timeline
    from arpd.model.plan import TopicPlan
    from arpd.model.settings import Settings

RCLPY_DEPTH = 10  # what every rclpy tutorial passes


@dataclass(frozen=True, kw_only=True, slots=True)
class SimTopic:
    """One topic of the robot.

    Parameters
    ----------
    name : as the application calls it
    payload_bytes : serialized size of a sample (bytes)
    rate_hz : rate the application publishes at (Hz)
    direction : which way it crosses the link
    prefix : the relay carries it as ``prefix + name``; empty when its own publisher is adaptive
    """

    name: str
    payload_bytes: int
    rate_hz: float
    direction: Direction = Direction.SENSING
    prefix: str = ""


def configured_topics(settings: Settings, *, actuation: Collection[str]) -> tuple[SimTopic, ...]:
    """Return the robot that a configuration describes: every topic of which it says what it publishes.

    Parameters
    ----------
    settings : the configuration
    actuation : names of topics that cross towards the robot; it does not say which do
    """
    relayed = {settings.relay.prefix + name: name for name in settings.relay.topics}
    return tuple(
        SimTopic(
            name=relayed.get(each.topic, each.topic),
            payload_bytes=max(1, round(each.payload_bytes)),
            rate_hz=each.source_rate_hz,
            direction=Direction.ACTUATION if each.topic in actuation else Direction.SENSING,
            prefix=settings.relay.prefix if each.topic in relayed else "",
        )
        for each in assumed_traffic(settings)
        if each.source_rate_hz > 0
    )


class SimulatedPublisher:
    """What `arpd.adapters.ros.publisher.AdaptivePublisher` is, over a simulated writer: the same pacer, the same swap.

    Until somebody retunes it, it behaves as a plain rclpy publisher.

    Parameters
    ----------
    topic : what is published
    name : topic name on the link
    node : node it lives in
    heartbeat_s : of its writers (s)
    ingress_s : age of a sample when it gets here: the relay's hop (s)
    """

    def __init__(
        self, route: LinkPath, topic: SimTopic, *, name: str, node: str, heartbeat_s: float, ingress_s: float = 0.0
    ) -> None:
        self.topic = topic
        self.arrivals = Arrivals()
        self._writers = 0
        self._timeline = route.timeline
        self._node = node
        self._ingress_s = ingress_s
        self._flow = Flow(
            create=partial(self._create, route, topic.payload_bytes, heartbeat_s),
            qos=WriterQos(depth=RCLPY_DEPTH, deadline_ns=0),
            overflow=Overflow.LATEST,
            clock=lambda: route.timeline.now_s,
        )
        self._alarm = Alarm(route.timeline, self._service)
        self._state = PublisherState(
            node=node,
            topic=name,
            type_name="sim",
            direction=topic.direction,
            payload_bytes=0.0,
            source_rate_hz=0.0,
            depth=RCLPY_DEPTH,
            baseline_depth=RCLPY_DEPTH,
            remote_readers=1,
        )

    def publish(self) -> None:
        """Let the source publish its next sample."""
        self._flow.publish(SAMPLE.pack(self._flow.offered, self._timeline.now_s - self._ingress_s))
        self._service()

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings: pacing changes now, depth and deadline by a swap."""
        self._flow.retune(plan, qos=WriterQos(depth=plan.depth, deadline_ns=plan.deadline_ns))
        self._service()

    def set_gate(self, gate: float | None) -> None:
        """Scale the paced rate, not below its floor; None = no daemon is heard, and the gate open."""
        self._flow.set_gate(gate)
        self._service()

    @property
    def swaps(self) -> int:
        """Writers made to take another's place, since the start."""
        return self._writers - 1

    def state(self, *, generation: int) -> PublisherState:
        """Announce what is in force."""
        flow = self._flow.state()
        counted = {field.name: getattr(flow, field.name) for field in fields(flow)}
        # The samples of the simulation are small tokens: the payload is the real topic's.
        counted["payload_bytes"] = float(self.topic.payload_bytes) if flow.offered else 0.0
        return replace(self._state, generation=generation, **counted)

    def result(self) -> TopicResult:
        """Sum up the run."""
        flow = self._flow.state()
        return TopicResult(
            topic=self.topic.name,
            source_rate_hz=self.topic.rate_hz,
            expected=flow.offered,
            offered=flow.offered,
            withheld=flow.withheld,
            sent=flow.published,
            **asdict(self.arrivals.reception()),
        )

    def _create(self, route: LinkPath, payload_bytes: int, heartbeat_s: float, qos: WriterQos) -> SimulatedWriter:
        self._writers += 1
        return SimulatedWriter(route, self.arrivals, payload_bytes=payload_bytes, qos=qos, heartbeat_s=heartbeat_s)

    def _service(self) -> None:
        due_s = self._flow.service(self._timeline.now_s)
        if due_s < self._alarm.when_s:
            self._alarm.set(due_s)


class SampleSource:
    """A timer that publishes, with the jitter of an executor; from ``start_s`` to ``end_s``.

    Parameters
    ----------
    publish : called at every period
    random : source of phase and jitter
    """

    def __init__(
        self,
        timeline: Timeline,
        publish: Callable[[], None],
        *,
        rate_hz: float,
        start_s: float,
        end_s: float,
        random: Random,
    ) -> None:
        self._timeline = timeline
        self._publish = publish
        self._period_s = 1.0 / rate_hz
        self._end_s = end_s
        self._random = random
        self._due_s = start_s + random.random() * self._period_s
        timeline.at(self._due_s, self._fire)

    def _fire(self) -> None:
        self._publish()
        self._due_s += self._period_s
        if self._due_s < self._end_s:
            self._timeline.at(self._due_s + min(0.002, self._random.expovariate(2000.0)), self._fire)
