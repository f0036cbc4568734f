"""The demo robot in virtual time: its topics, their sources, and publishers with arpd's own pacing and swap."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.model import Direction, PublisherState, TopicPlan
from arpd.pacing import Pacer
from arpd.settings import Overflow
from arpd.sim.link import Alarm
from arpd.sim.result import TopicResult, percentile
from arpd.sim.writer import SAMPLE, Arrivals, Route, SimulatedWriter
from arpd.swap import WriterQos, WriterSwap

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from arpd.sim.link import Timeline
    from arpd.swap import SwapResult

RCLPY_DEPTH = 10  # what every rclpy tutorial passes
PREFIX = "/link"
_POLL_S = 0.005  # how often a swap looks at its writers, as in arpd.ros.publisher
_RATE_WINDOW_S, _RATE_SETTLE_S, _SILENT_PERIODS = 5.0, 0.5, 3.0  # as in arpd.ros.publisher


@dataclass(frozen=True, kw_only=True, slots=True)
class SimTopic:
    """One topic of the robot: serialized payload (bytes) and source rate (Hz)."""

    name: str
    payload_bytes: int
    rate_hz: float
    direction: Direction = Direction.SENSING


DEMO_TOPICS = (
    SimTopic(name="/scan/front", payload_bytes=5800, rate_hz=20.0),
    SimTopic(name="/scan/rear", payload_bytes=5800, rate_hz=20.0),
    SimTopic(name="/camera/image/compressed", payload_bytes=30_000, rate_hz=30.0),
    SimTopic(name="/points", payload_bytes=16_400, rate_hz=10.0),
    SimTopic(name="/imu", payload_bytes=330, rate_hz=200.0),
    SimTopic(name="/odom", payload_bytes=730, rate_hz=50.0),
    SimTopic(name="/joint_states", payload_bytes=600, rate_hz=50.0),
    SimTopic(name="/battery", payload_bytes=250, rate_hz=1.0),
    SimTopic(name="/gps/fix", payload_bytes=130, rate_hz=5.0),
    SimTopic(name="/temperature", payload_bytes=60, rate_hz=2.0),
    SimTopic(name="/range/front", payload_bytes=60, rate_hz=20.0),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=20.0, direction=Direction.ACTUATION),
)


class SimulatedPublisher:
    """What `arpd.ros.publisher.AdaptivePublisher` is, over a simulated writer: the same pacer, the same swap.

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
        self, route: Route, topic: SimTopic, *, name: str, node: str, heartbeat_s: float, ingress_s: float = 0.0
    ) -> None:
        self.topic = topic
        self.arrivals = Arrivals()
        self._timeline = route.timeline
        self._node = node
        self._ingress_s = ingress_s
        self._baseline = WriterQos(depth=RCLPY_DEPTH, deadline_ns=0)
        self._swaps: Counter[str] = Counter()
        create = partial(self._create, route, topic.payload_bytes, heartbeat_s)
        self._swap = WriterSwap(create=create, on_result=self._on_swap, qos=self._baseline)
        self._pacer = Pacer(overflow=Overflow.LATEST, depth=RCLPY_DEPTH, on_withheld=self._on_withheld)
        self._plan = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=RCLPY_DEPTH)
        self._gate = 1.0
        self._alarm = Alarm(route.timeline, self._service)
        self._offered_at: deque[tuple[float, int]] = deque()  # marks of (time, samples offered by then)
        self._last_offered_s = -math.inf
        self._state = PublisherState(
            node=node,
            topic=name,
            type_name="sim",
            direction=topic.direction,
            payload_bytes=0.0,
            source_rate_hz=0.0,
            offered=0,
            published=0,
            withheld=0,
            queued=0,
            blocked_s=0.0,
            rate_hz=math.inf,
            depth=RCLPY_DEPTH,
            deadline_ns=0,
            baseline_depth=RCLPY_DEPTH,
            baseline_deadline_ns=0,
            generation=0,
            remote_readers=1,
        )
        self.offered = self.published = self.withheld = 0

    def publish(self) -> None:
        """Let the source publish its next sample."""
        now_s = self._timeline.now_s
        sample = SAMPLE.pack(self.offered, now_s - self._ingress_s)
        self._count_offered(now_s)
        self._pacer.offer(sample)
        self._release(now_s)
        self._arm(now_s)

    def retune(self, plan: TopicPlan) -> None:
        """Take new settings: pacing changes now, depth and deadline by a swap."""
        now_s = self._timeline.now_s
        self._plan = plan
        self._apply_rate(now_s)
        period_s = 1.0 / max(min(plan.rate_hz, self._source_rate_hz(now_s)), 1e-3)
        self._swap.request(WriterQos(depth=plan.depth, deadline_ns=plan.deadline_ns), hold_s=2.0 * period_s)
        self._arm(now_s)

    def set_gate(self, gate: float) -> None:
        """Scale the paced rate, not below its floor."""
        if gate != self._gate:
            self._gate = gate
            self._apply_rate(self._timeline.now_s)
            self._arm(self._timeline.now_s)

    def state(self, *, generation: int) -> PublisherState:
        """Announce what is in force."""
        now_s = self._timeline.now_s
        rate_hz = self._source_rate_hz(now_s)
        if self._offered_at and self.offered > self._offered_at[-1][1]:
            self._offered_at.append((self._last_offered_s, self.offered))
        while len(self._offered_at) > 2 and now_s - self._offered_at[1][0] >= _RATE_WINDOW_S:
            self._offered_at.popleft()
        return replace(
            self._state,
            payload_bytes=float(self.topic.payload_bytes) if self.offered else 0.0,
            source_rate_hz=rate_hz,
            offered=self.offered,
            published=self.published,
            withheld=self.withheld,
            queued=len(self._pacer),
            rate_hz=self._plan.rate_hz,
            depth=self._swap.qos.depth,
            deadline_ns=self._swap.qos.deadline_ns,
            generation=generation,
            swaps_by_result=dict(self._swaps),
        )

    def result(self) -> TopicResult:
        """Sum up the run."""
        seen = self.arrivals
        return TopicResult(
            topic=self.topic.name,
            source_rate_hz=self.topic.rate_hz,
            offered=self.offered,
            withheld=self.withheld,
            sent=self.published,
            received=len(seen.sequences),
            doubled=seen.doubled,
            reordered=seen.reordered,
            delivered_bytes=len(seen.sequences) * self.topic.payload_bytes,
            latency_p50_s=percentile(seen.latencies_s, 0.5),
            latency_p99_s=percentile(seen.latencies_s, 0.99),
            latency_max_s=max(seen.latencies_s, default=None),
            age_p50_s=percentile(seen.ages_s, 0.5),
            age_p99_s=percentile(seen.ages_s, 0.99),
        )

    def _create(self, route: Route, payload_bytes: int, heartbeat_s: float, qos: WriterQos) -> SimulatedWriter:
        return SimulatedWriter(route, self.arrivals, payload_bytes=payload_bytes, qos=qos, heartbeat_s=heartbeat_s)

    def _service(self) -> None:
        now_s = self._timeline.now_s
        if self._swap.is_busy:
            self._swap.step(now_s)
        self._release(now_s)
        self._arm(now_s)

    def _arm(self, now_s: float) -> None:
        due_s = now_s + _POLL_S if self._swap.is_busy else math.inf
        if not self._swap.is_holding:
            due_s = min(due_s, self._pacer.due_s(now_s))
        if due_s < self._alarm.when_s:
            self._alarm.set(due_s)

    def _release(self, now_s: float) -> None:
        while not self._swap.is_holding and (sample := self._pacer.take(now_s)) is not None:
            self._swap.current.publish(sample)
            self.published += 1

    def _apply_rate(self, now_s: float) -> None:
        rate_hz, source_hz = self._plan.rate_hz, self._source_rate_hz(now_s)
        if self._gate < 1.0:
            flowing_hz = min(rate_hz, source_hz) if source_hz > 0 else rate_hz
            rate_hz = max(flowing_hz * self._gate, min(self._plan.min_rate_hz, rate_hz))
        self._pacer.retune(rate_hz=rate_hz, depth=self._plan.depth, now_s=now_s)

    def _count_offered(self, now_s: float) -> None:
        self.offered += 1
        if now_s - self._last_offered_s > _RATE_WINDOW_S:
            self._offered_at = deque([(now_s, self.offered)])
        self._last_offered_s = now_s

    def _source_rate_hz(self, now_s: float) -> float:
        if not self._offered_at or self.offered == self._offered_at[0][1]:
            return 0.0
        since_s, count = self._offered_at[0]
        samples, span_s = self.offered - count, self._last_offered_s - since_s
        if now_s - self._last_offered_s > _SILENT_PERIODS * span_s / samples + _RATE_SETTLE_S:
            return 0.0
        return samples / span_s if span_s > 0 and now_s - since_s >= _RATE_SETTLE_S else 0.0

    def _on_withheld(self, samples: int) -> None:
        self.withheld += samples

    def _on_swap(self, result: SwapResult) -> None:
        self._swaps[result.value] += 1


class Source:
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
