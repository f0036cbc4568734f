"""A run of arpd in virtual time: the daemon's own tick over a simulated robot and link, without ROS or waiting."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from random import Random
from typing import TYPE_CHECKING, Any

from arpd.daemon.supervisor import LEAST_PAUSE_S
from arpd.daemon.tick import TICK_S, Daemon
from arpd.model.endpoints import Direction
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.wire import HEARTBEAT_S
from arpd.sim.demo import demo_topics
from arpd.sim.ends import SimulatedEnd, SimulatedLinkTopic
from arpd.sim.link import CrossFlow, LinkModel, Loopback, SimulatedLink
from arpd.sim.oracle import Oracle
from arpd.sim.robot import SimulatedPublisher, SimulatedThread, play_source
from arpd.sim.schedule import RateSchedule, Service
from arpd.sim.socket import SOCKET_BYTES, Carrier
from arpd.sim.timeline import Alarm, Timeline
from arpd.sim.world import PLANNER, RELAY, SimulatedWorld

if TYPE_CHECKING:
    from arpd.model.settings import Settings
    from arpd.sim.result import SimTopic, TopicResult

_LEAD_S = 3.0  # daemon, relay and peer run this long before the sensors publish
_DRAIN_S = 4.0  # as in the real demo: late samples still count as delivered
_AGE_S = 0.05
_SHOW_S = 0.1
_UNIX_S = 1.7e9
_TRUTH_S = 0.2  # the bound knows the mean rate of this time ahead; nobody could follow faster changes
_PLAIN_HEARTBEAT_S = 3.0  # Fast DDS's default
_RELAY_HOP_S = 0.0005
_ON_HOST_S = 0.001


class Way(StrEnum):
    """What governs the robot."""

    ARPD = "arpd"
    WITHOUT = "without"  # nothing: rclpy's defaults (RELIABLE, KEEP_LAST 10), unpaced
    ORACLE = "oracle"  # arpd, with an oracle that knows the link in place of its estimator


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
    allowed : part of the traffic above the floors that the price allows, 0..1
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
    state: LinkState | None = None
    allowed: float = 1.0
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


@dataclass(frozen=True, slots=True)
class Scenario:
    """A robot on a link.

    Parameters
    ----------
    settings : configuration of arpd; unused without arpd
    schedule : rate of the link over run time, each way
    duration_s : length of the run (s)
    seed : of phases, jitter and losses; the same seed gives the same result
    model : delay, queue and loss of the link
    topics : topics of the robot
    cross_traffic : flows from the robot that are not arpd's
    into_peer : other traffic that the peer's interface receives without crossing this link
    has_peer : whether a peer receives probes and sends reports
    """

    settings: Settings
    schedule: RateSchedule
    duration_s: float
    seed: int = 1
    way: Way = Way.ARPD
    model: LinkModel = field(default_factory=LinkModel)
    topics: tuple[SimTopic, ...] = field(default_factory=demo_topics)
    cross_traffic: tuple[CrossFlow, ...] = ()
    into_peer: tuple[CrossFlow, ...] = ()
    has_peer: bool = True

    def play(self) -> ScenarioResult:
        """Run the robot in virtual time; run time begins with its sensors."""
        return _Run(self).play()


class _Run:
    """Links, publishers, sources and perhaps arpd of one run, and the moments recorded."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._is_managed = scenario, scenario.way is not Way.WITHOUT
        self._timeline = timeline = Timeline(-_LEAD_S)
        self._service = Service(scenario.schedule)
        self._up, self._down = (
            SimulatedLink(timeline, scenario.schedule, model=scenario.model, random=self._random(f"link {name}"))
            for name in ("up", "down")
        )
        for flow in scenario.cross_traffic:
            flow.play(timeline, self._up)
        self._publishers: list[SimulatedPublisher | SimulatedLinkTopic] = []
        self._moments: list[Moment] = []
        self._causes: list[str] = []  # of the plans since the last moment
        self._end: SimulatedEnd | None = None  # the robot's, of a relay with two
        self._populate()
        if self._is_managed:
            self._govern()

    def _random(self, purpose: str) -> Random:
        """Make a separate source of randomness for each part, so that no part changes another's."""
        return Random(f"{self._scenario.seed} {purpose}")  # noqa: S311 - a repeatable run, not a secret

    def _populate(self) -> None:
        """Make a publisher and a source per topic; a relay's two ends carry all that crosses the link."""
        scenario, timeline = self._scenario, self._timeline
        threads = {node: SimulatedThread(timeline) for node in (RELAY, PLANNER)}
        ends: dict[str, SimulatedEnd] = {}
        if self._is_managed and scenario.settings.relay.link_domain is not None:
            self._end = near = SimulatedEnd(timeline, there=self._up, back=self._down, session=1)
            far = SimulatedEnd(timeline, there=self._down, back=self._up, session=2)
            near.start(far)
            far.start(near)
            ends = {RELAY: near, PLANNER: far}
        for topic in scenario.topics:
            node = PLANNER if topic.direction is Direction.ACTUATION else RELAY
            publisher: SimulatedPublisher | SimulatedLinkTopic
            if ends and topic.direction is not Direction.LOCAL:
                publisher = SimulatedLinkTopic(topic, end=ends[node], node=node, ingress_s=_RELAY_HOP_S)
            else:
                publisher = self._publisher(topic, node, threads[node])
            self._publishers.append(publisher)
            random = self._random(topic.name)
            play_source(timeline, publisher.publish, rate_hz=topic.rate_hz, end_s=scenario.duration_s, random=random)

    def _publisher(self, topic: SimTopic, node: str, thread: SimulatedThread) -> SimulatedPublisher:
        host, managed = Loopback(self._timeline), self._is_managed
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
            room_bytes=SOCKET_BYTES if self._scenario.model.pushes_back else math.inf,
            name=topic.prefix + topic.name if relayed else topic.name,
            node=node,
            heartbeat_s=HEARTBEAT_S if managed else _PLAIN_HEARTBEAT_S,
            ingress_s=_RELAY_HOP_S if relayed else 0.0,
            thread=thread,
        )

    def _govern(self) -> None:
        scenario, clock = self._scenario, self._timeline
        ticked_s = clock.now_s

        def wake() -> None:
            alarm.set(min(alarm.when_s, max(clock.now_s + _ON_HOST_S, ticked_s + LEAST_PAUSE_S)))

        def tick() -> None:
            nonlocal ticked_s
            ticked_s = clock.now_s
            decision = self._daemon.tick(clock.now_s)
            alarm.set(ticked_s + self._daemon.pause_s)
            if decision.reason:
                self._causes.append(decision.reason)

        self._world = SimulatedWorld(
            clock,
            up=self._up,
            down=self._down,
            publishers=self._publishers,
            end=self._end,
            random=self._random("world"),
            on_report=wake,
            into_peer=scenario.into_peer,
            has_peer=scenario.has_peer,
        )
        self._daemon = Daemon(
            self._world,
            scenario.settings,
            clock=lambda: clock.now_s,
            wall_clock=lambda: _UNIX_S + clock.now_s,
            estimator=Oracle(self._truth) if scenario.way is Way.ORACLE else None,
        )
        alarm = Alarm(clock, tick)
        alarm.set(clock.now_s + TICK_S)

    def play(self) -> ScenarioResult:
        """Run to the end, and record a moment ten times a second."""
        self._timeline.every(_AGE_S, self._sample_ages, first_s=_AGE_S)
        self._timeline.every(_SHOW_S, self._show, first_s=0.0)
        self._timeline.run_until(self._scenario.duration_s + _DRAIN_S)
        return ScenarioResult(
            topics=tuple(publisher.result() for publisher in self._publishers), moments=tuple(self._moments)
        )

    def _truth(self) -> LinkEstimate:
        """Return the true state of the link: the rates of the next 0.2 s, and the queue of now; nobody's ticks rest."""
        model, run_s = self._scenario.model, max(0.0, self._timeline.now_s)
        rate, loss_ratio = self._mean_rate(run_s, _TRUTH_S), model.loss_ratio(run_s)
        is_out = rate <= 0.0 or loss_ratio >= 1.0
        cross_bytes = sum(
            flow.offered_bytes(run_s + _TRUTH_S) - flow.offered_bytes(run_s) for flow in self._scenario.cross_traffic
        )
        return LinkEstimate(
            capacity_bytes_per_second=rate,
            kind=CapacityKind.CONFIGURED,
            state=LinkState.OUTAGE if is_out else LinkState.STEADY,
            age_s=0.0,
            evidence="the truth",
            queue_delay_s=self._up.queue_delay_s,
            cross_traffic_bytes_per_second=cross_bytes / _TRUTH_S,
            delivery_rate_bytes_per_second=rate,
            # Aggregates are full on a busy link.
            packet_overhead_s=model.packet_overhead_s / model.aggregate_packets,
            loss_ratio=None if is_out else loss_ratio,
        )

    def _mean_rate(self, start_s: float, span_s: float) -> float:
        """Return the mean rate over a span of run time; a recorded one changes within the span (bytes/s)."""
        return (self._service.by(start_s + span_s) - self._service.by(start_s)) / span_s

    def _sample_ages(self) -> None:
        if self._timeline.now_s < self._scenario.duration_s:
            for publisher in self._publishers:
                publisher.arrivals.note_age()

    def _show(self) -> None:
        t_s = round(self._timeline.now_s, 6)  # so that people can read it
        if t_s < self._scenario.duration_s:
            sensing = (each for each in self._publishers if each.topic.direction is Direction.SENSING)
            moment = Moment(
                t_s=t_s,
                truth_bytes_per_second=self._mean_rate(t_s, _SHOW_S),
                queue_delay_s=self._up.queue_delay_s,
                delivered_bytes=sum(publisher.arrivals.delivered_bytes for publisher in sensing),
                carried_bytes=self._up.received_bytes(),
                swaps=sum(publisher.swaps for publisher in self._publishers),
                **self._shown(),
            )
            self._moments.append(moment)

    def _shown(self) -> dict[str, Any]:
        if not self._is_managed or (snapshot := self._daemon.snapshot) is None:
            return {}
        cause, self._causes = ", ".join(self._causes), []
        return {
            "estimate_bytes_per_second": snapshot.link.capacity_bytes_per_second,
            "cross_traffic_bytes_per_second": snapshot.link.cross_traffic_bytes_per_second,
            "level_bytes_per_second": snapshot.decision.plan.level_bytes_per_second,
            "budget_bytes_per_second": snapshot.allocation.budget_bytes_per_second,
            "state": snapshot.link.state,
            "allowed": snapshot.decision.allowed,
            "planned": len(snapshot.decision.plan.topics),
            "confirmed": snapshot.confirmed,
            "cause": cause,
            "probe_bytes": self._daemon.record.probe_bytes,
            "report_bytes": self._world.report_bytes,
        }
