"""A run of arpd in virtual time: the daemon's own tick over a simulated robot and link, without ROS or waiting."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from random import Random
from typing import TYPE_CHECKING

from arpd.daemon.supervisor import LEAST_PAUSE_S
from arpd.daemon.tick import TICK_S, Daemon
from arpd.model.endpoints import Direction
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.wire import HEARTBEAT_S
from arpd.sim.demo import demo_topics
from arpd.sim.ends import SimulatedEnd, SimulatedLinkTopic
from arpd.sim.link import LinkModel, Loopback, SimulatedLink
from arpd.sim.robot import SampleSource, SimulatedPublisher, SimulatedThread
from arpd.sim.schedule import Service
from arpd.sim.socket import SOCKET_BYTES
from arpd.sim.timeline import Alarm, Timeline
from arpd.sim.world import PLANNER, RELAY, SimulatedWorld

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from arpd.model.settings import Settings
    from arpd.sim.baselines import Oracle
    from arpd.sim.link import ForeignFlow
    from arpd.sim.result import TopicResult
    from arpd.sim.robot import SimTopic
    from arpd.sim.schedule import RateSchedule
    from arpd.sim.socket import Carrier

    EstimatorMaker: TypeAlias = Callable[[Callable[[], LinkEstimate]], Oracle]

_RUN_STARTS_S = 1000.0  # monotonic time at which run time is 0
_LEAD_S = 3.0  # daemon, relay and peer run this long before the sensors publish
_DRAIN_S = 4.0  # as in the real demo: late samples still count as delivered
_AGE_S = 0.05
_SHOW_S = 0.1
_UNIX_S = 1.7e9
_TRUTH_S = 0.2  # the bound knows the mean rate of this time ahead; nobody could follow faster changes
_PLAIN_HEARTBEAT_S = 3.0  # Fast DDS's default
_RELAY_HOP_S = 0.0005
_ON_HOST_S = 0.001


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """Truth and estimates at one moment, ten times a second; estimates are None without arpd.

    Parameters
    ----------
    t_s : run time (s)
    truth_bytes_per_second : mean rate of the link until the next moment (bytes/s)
    queue_delay_s : time that a packet sent now would wait on the robot's side (s)
    estimate_bytes_per_second, cross_traffic_bytes_per_second : the estimator's capacity and cross traffic (bytes/s)
    level_bytes_per_second : level of the plan in force (bytes/s)
    budget_bytes_per_second : total that the topics may use now (bytes/s)
    packet_overhead_s : the estimator's link time per packet beyond its bytes (s)
    allowed : part of the traffic above the floors that the price allows, 0..1
    generation : generation of the plan
    planned, confirmed : publishers in the plan, and those that announce it
    cause : cause of a plan made since the last moment, empty if there is none
    delivered_bytes : payload from the robot that has reached its readers across the link so far (bytes)
    carried_bytes : everything that the link has carried from the robot so far (wire bytes)
    probe_bytes, report_bytes : probes and reports so far (wire bytes)
    swaps : writer swaps begun so far, all topics together
    """

    t_s: float
    truth_bytes_per_second: float
    queue_delay_s: float
    estimate_bytes_per_second: float | None = None
    cross_traffic_bytes_per_second: float | None = None
    level_bytes_per_second: float | None = None
    budget_bytes_per_second: float | None = None
    packet_overhead_s: float | None = None
    state: LinkState | None = None
    allowed: float = 1.0
    generation: int = 0
    planned: int = 0
    confirmed: int = 0
    cause: str = ""
    delivered_bytes: int = 0
    carried_bytes: float = 0.0
    probe_bytes: int = 0
    report_bytes: int = 0
    swaps: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioResult:
    """Result of one run: figures per topic, and the course of the link and of the estimates."""

    topics: tuple[TopicResult, ...]
    moments: tuple[Moment, ...]

    @property
    def plans(self) -> tuple[Moment, ...]:
        """Moments with a new plan."""
        return tuple(moment for moment in self.moments if moment.cause)


def run(
    settings: Settings,
    schedule: RateSchedule,
    duration_s: float,
    *,
    seed: int,
    managed: bool,
    model: LinkModel | None = None,
    foreign: tuple[ForeignFlow, ...] = (),
    topics: tuple[SimTopic, ...] | None = None,
    into_peer: tuple[ForeignFlow, ...] = (),
    has_peer: bool = True,
    make_estimator: EstimatorMaker | None = None,
) -> ScenarioResult:
    """Run a robot for ``duration_s`` of virtual time.

    Parameters
    ----------
    settings : configuration of arpd; unused without arpd
    schedule : rate of the link over run time, each way
    seed : of phases, jitter and losses; the same seed gives the same result
    managed : with arpd; otherwise rclpy's defaults (RELIABLE, KEEP_LAST 10), unpaced
    model : delay, queue, loss and outages of the link
    foreign : cross traffic from the robot
    topics : topics of the robot; the demo robot's by default
    into_peer : other traffic that the peer's interface receives without crossing this link
    has_peer : whether a peer receives probes and sends reports
    make_estimator : makes an estimator from a function that returns the truth; arpd's own by default
    """
    run_ = _Run(
        schedule,
        duration_s,
        seed=seed,
        model=model or LinkModel(),
        foreign=foreign,
        topics=demo_topics() if topics is None else topics,
    )
    run_.populate(managed=managed, has_ends=managed and settings.relay.link_domain is not None)
    if managed:
        run_.govern(settings, make_estimator, into_peer=into_peer, has_peer=has_peer)
    return run_.play()


class _Run:
    """Links, publishers, sources and perhaps arpd of one run, and the moments recorded."""

    def __init__(
        self,
        schedule: RateSchedule,
        duration_s: float,
        *,
        seed: int,
        model: LinkModel,
        foreign: tuple[ForeignFlow, ...],
        topics: tuple[SimTopic, ...],
    ) -> None:
        self._timeline = Timeline(_RUN_STARTS_S - _LEAD_S)
        self._service = Service(schedule, 0.0)
        self._model, self._cross_traffic, self._topics, self._seed = model, foreign, topics, seed
        self._end_s = _RUN_STARTS_S + duration_s
        self._up, self._down = (
            SimulatedLink(
                self._timeline, schedule, origin_s=_RUN_STARTS_S, model=model, random=self._random(f"link {name}")
            )
            for name in ("up", "down")
        )
        for flow in foreign:
            flow.play(self._timeline, self._up, origin_s=_RUN_STARTS_S)
        self._received: deque[tuple[float, float]] = deque()  # when (s), bytes
        self._publishers: list[SimulatedPublisher | SimulatedLinkTopic] = []
        self._ends: dict[str, SimulatedEnd] = {}  # of a relay with two ends, by node
        self._moments: list[Moment] = []
        self._world: SimulatedWorld | None = None  # with arpd
        self._daemon: Daemon | None = None
        self._causes: list[str] = []  # of the plans since the last moment

    def _random(self, purpose: str) -> Random:
        """Make a separate source of randomness for each part, so that no part changes another's."""
        return Random(f"{self._seed} {purpose}")  # noqa: S311 - a repeatable run, not a secret

    def populate(self, *, managed: bool, has_ends: bool) -> None:
        """Make a publisher and a source per topic.

        Parameters
        ----------
        managed : with arpd, where relayed topics have the relay's prefix
        has_ends : with a relay's two ends, which carry all that crosses the link
        """
        threads = {node: SimulatedThread(self._timeline) for node in (RELAY, PLANNER)}
        if has_ends:
            near = SimulatedEnd(self._timeline, there=self._up, back=self._down, session=1)
            far = SimulatedEnd(self._timeline, there=self._down, back=self._up, session=2)
            near.start(far)
            far.start(near)
            self._ends = {RELAY: near, PLANNER: far}
        for topic in self._topics:
            node = PLANNER if topic.direction is Direction.ACTUATION else RELAY
            publisher: SimulatedPublisher | SimulatedLinkTopic
            if has_ends and topic.direction is not Direction.LOCAL:
                publisher = SimulatedLinkTopic(topic, end=self._ends[node], node=node, ingress_s=_RELAY_HOP_S)
            else:
                publisher = self._publisher(topic, node, threads[node], managed=managed)
            self._publishers.append(publisher)
            SampleSource(
                self._timeline,
                publisher.publish,
                rate_hz=topic.rate_hz,
                start_s=_RUN_STARTS_S,
                end_s=self._end_s,
                random=self._random(topic.name),
            )

    def _publisher(self, topic: SimTopic, node: str, thread: SimulatedThread, *, managed: bool) -> SimulatedPublisher:
        host = Loopback(self._timeline)
        ways: dict[Direction, tuple[Carrier, Carrier]] = {
            Direction.LOCAL: (host, host),
            Direction.SENSING: (self._up, self._down),
            Direction.ACTUATION: (self._down, self._up),
        }
        there, back = ways[topic.direction]
        relayed = managed and bool(topic.prefix)
        return SimulatedPublisher(
            self._timeline,
            topic,
            there=there,
            back=back,
            room_bytes=SOCKET_BYTES if self._model.pushes_back else math.inf,
            name=topic.prefix + topic.name if relayed else topic.name,
            node=node,
            heartbeat_s=HEARTBEAT_S if managed else _PLAIN_HEARTBEAT_S,
            ingress_s=_RELAY_HOP_S if relayed else 0.0,
            thread=thread,
        )

    def govern(
        self,
        settings: Settings,
        make_estimator: EstimatorMaker | None,
        *,
        into_peer: tuple[ForeignFlow, ...],
        has_peer: bool,
    ) -> None:
        """Let arpd manage the publishers."""
        clock = self._timeline
        ticked_s = clock.now_s

        def wake() -> None:
            alarm.set(min(alarm.when_s, max(clock.now_s + _ON_HOST_S, ticked_s + LEAST_PAUSE_S)))

        def tick() -> None:
            nonlocal ticked_s
            ticked_s = clock.now_s
            decision = daemon.tick(clock.now_s)
            alarm.set(ticked_s + daemon.pause_s)
            if decision.level_changed:
                self._causes.append(decision.reason)

        self._world = SimulatedWorld(
            clock,
            up=self._up,
            down=self._down,
            publishers=self._publishers,
            end=self._ends.get(RELAY),
            random=self._random("world"),
            graph=settings.graph,
            on_report=wake,
            into_peer=tuple(flow.after(_RUN_STARTS_S) for flow in into_peer),
            has_peer=has_peer,
        )
        daemon = self._daemon = Daemon(
            self._world,
            settings,
            interface="sim0",
            clock=lambda: clock.now_s,
            wall_clock=lambda: _UNIX_S + clock.now_s,
            estimator=make_estimator(self._truth) if make_estimator else None,
        )
        alarm = Alarm(clock, tick)
        alarm.set(clock.now_s + TICK_S)

    def play(self) -> ScenarioResult:
        """Run to the end, and record a moment ten times a second."""
        self._timeline.every(_AGE_S, self._sample_ages, first_s=_RUN_STARTS_S + _AGE_S)
        self._timeline.every(_SHOW_S, self._show, first_s=_RUN_STARTS_S)
        self._timeline.run_until(self._end_s + _DRAIN_S)
        return ScenarioResult(
            topics=tuple(publisher.result() for publisher in self._publishers), moments=tuple(self._moments)
        )

    def _truth(self) -> LinkEstimate:
        """Return the true state of the link: the rates of the next 0.2 s, and the queue and the delivery of now."""
        run_s = max(0.0, self._timeline.now_s - _RUN_STARTS_S)
        rate = self._mean_rate(run_s, _TRUTH_S)
        is_out = rate <= 0 or self._model.is_out(run_s)
        return LinkEstimate(
            capacity_bytes_per_second=rate,
            kind=CapacityKind.CONFIGURED,
            state=LinkState.OUTAGE if is_out else LinkState.STEADY,
            age_s=0.0,
            evidence="the truth",
            queue_delay_s=self._up.queue_delay_s,
            cross_traffic_bytes_per_second=sum(
                flow.offered_bytes(run_s + _TRUTH_S) - flow.offered_bytes(run_s) for flow in self._cross_traffic
            )
            / _TRUTH_S,
            delivery_rate_bytes_per_second=self._delivered_bytes_per_second(),
            # Aggregates are full on a busy link.
            packet_overhead_s=self._model.packet_overhead_s / self._model.aggregate_packets,
            loss_ratio=None if is_out else self._model.loss_ratio(run_s),
        )

    def _mean_rate(self, start_s: float, span_s: float) -> float:
        """Return the mean rate over a span of run time; a recorded one changes within the span (bytes/s)."""
        return (self._service.by(start_s + span_s) - self._service.by(start_s)) / span_s

    def _delivered_bytes_per_second(self) -> float:
        """Return the rate at which bytes arrived over about the last 0.2 s (bytes/s)."""
        now_s, received = self._timeline.now_s, self._received
        received.append((now_s, self._up.received_bytes()))
        while len(received) > 1 and received[1][0] <= now_s - _TRUTH_S:
            received.popleft()
        span_s = now_s - received[0][0]
        return (received[-1][1] - received[0][1]) / span_s if span_s > 0 else 0.0

    def _sample_ages(self) -> None:
        if self._timeline.now_s < self._end_s:
            for publisher in self._publishers:
                publisher.arrivals.on_age(self._timeline.now_s)

    def _show(self) -> None:
        if self._timeline.now_s >= self._end_s:
            return
        t_s = round(self._timeline.now_s - _RUN_STARTS_S, 6)  # so that people can read it
        moment = Moment(
            t_s=t_s,
            truth_bytes_per_second=self._mean_rate(t_s, _SHOW_S),
            queue_delay_s=self._up.queue_delay_s,
            delivered_bytes=sum(
                publisher.arrivals.delivered_bytes
                for publisher in self._publishers
                if publisher.topic.direction is Direction.SENSING
            ),
            carried_bytes=self._up.received_bytes(),
            swaps=sum(publisher.swaps for publisher in self._publishers),
        )
        if self._world is not None and self._daemon is not None and (snapshot := self._daemon.snapshot) is not None:
            moment = replace(
                moment,
                estimate_bytes_per_second=snapshot.link.capacity_bytes_per_second,
                cross_traffic_bytes_per_second=snapshot.link.cross_traffic_bytes_per_second,
                level_bytes_per_second=snapshot.decision.plan.level_bytes_per_second,
                budget_bytes_per_second=snapshot.allocation.capacity_bytes_per_second,
                packet_overhead_s=snapshot.link.packet_overhead_s,
                state=snapshot.link.state,
                allowed=snapshot.decision.allowed,
                generation=snapshot.decision.plan.generation,
                planned=len(snapshot.decision.plan.topics),
                confirmed=snapshot.confirmed,
                cause=", ".join(self._causes),
                probe_bytes=self._world.probes_sent()[1],
                report_bytes=self._world.report_bytes,
            )
            self._causes.clear()
        self._moments.append(moment)
