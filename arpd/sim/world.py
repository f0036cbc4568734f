"""The daemon's world over the simulated link: relay, planner node and peer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.estimate.receiver import Receiver
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import MemoryState, Observation
from arpd.model.probing import ProbeHeader
from arpd.model.relay import RelaySummary
from arpd.model.wire import probe_wire_bytes
from arpd.ros.nodes import SILENT_S
from arpd.ros.peer_reports import FORGOTTEN_S
from arpd.sim.link import FRAME_BYTES, CrossFlow, Loopback, SimulatedLink
from arpd.sim.timeline import Alarm, Timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence
    from random import Random

    from arpd.model.plan import QosPlan
    from arpd.model.price import Price
    from arpd.model.probing import PeerReport, ProbeRequest
    from arpd.sim.ends import SimulatedEnd, SimulatedLinkTopic
    from arpd.sim.robot import SimulatedPublisher
    from arpd.sim.socket import Carrier

    Managed = SimulatedPublisher | SimulatedLinkTopic

RELAY, PLANNER = "/arpd_relay", "/planner"
_PEER = "base"
_TELL_S = 1.0
_SILENT_S = 5.0  # as in arpd.endpoint.node_publishers
_AGAIN_S = 1.5  # nothing here repeats what is lost, as DDS does
_PEER_CLOCK_S = 3.217  # the base computer's clock is ahead by this, because nothing may depend on equal clocks
_STAMP_JITTER_S = 0.0002  # mean lateness of a receive time stamp
_PROBE_SPACING_S = 0.0001  # between the packets of a train; Python publishes no faster
_REPORT_BYTES, _PRICE_BYTES, _SNAPSHOT_BYTES, _PLAN_BYTES = 230, 210, 500, 700  # on the wire


@dataclass(slots=True)
class _Node:
    """One node with adaptive publishers, and what the daemon has asked of it."""

    publishers: list[Managed]
    there: Carrier  # way to it
    back: Carrier
    generation: int = 0
    lease_s: float = 0.0
    price: Price | None = None
    price_at_s: float = -math.inf
    announced: tuple[PublisherState, ...] = ()
    announced_at_s: float = -math.inf


class SimulatedWorld:
    """The world over the simulated link, which all traffic from and to remote nodes crosses; see `arpd.ros.world`.

    Parameters
    ----------
    up, down : the link, from and to the robot
    publishers : publishers that the daemon manages
    random : source of phases and jitter
    on_report : called when a peer report arrives, so that a tick can follow at once
    into_peer : other traffic that the peer's interface receives
    has_peer : whether a peer receives probes and sends reports
    end : the robot's end of a relay with two; then nothing that stays on its host is managed

    Attributes
    ----------
    report_bytes : wire bytes of all reports sent
    """

    def __init__(
        self,
        timeline: Timeline,
        *,
        up: SimulatedLink,
        down: SimulatedLink,
        publishers: Sequence[Managed],
        random: Random,
        on_report: Callable[[], None],
        into_peer: Sequence[CrossFlow] = (),
        has_peer: bool = True,
        end: SimulatedEnd | None = None,
    ) -> None:
        self._timeline, self._random = timeline, random
        self._up, self._down, self._into_peer, self._has_peer = up, down, into_peer, has_peer
        self._relay: RelaySummary | None = None
        self._on_report_arrived = on_report
        self._reports: list[PeerReport] = []
        self._reported_s = -math.inf  # when the peer was heard last
        self._asked_generation, self._asked_at_s = -1, -math.inf
        self.report_bytes = 0
        # The receiver on the base computer.
        self._receiver = Receiver(_PEER, self._soon_s(), (0, 0))
        self._stamp_s = -math.inf
        of = {direction: [p for p in publishers if p.topic.direction is direction] for direction in Direction}
        if end is not None:
            of[Direction.LOCAL] = []
            timeline.every(_TELL_S, partial(self._summarise, end), first_s=self._soon_s())
        host = Loopback(timeline)
        self._nodes = (
            _Node(of[Direction.SENSING] + of[Direction.LOCAL], there=host, back=host),
            _Node(of[Direction.ACTUATION], there=up, back=down),
        )
        self._counts = {direction: len(publishers) for direction, publishers in of.items()}
        for node in self._nodes:
            timeline.every(_TELL_S, partial(self._tell, node), first_s=self._soon_s())
        self._report_alarm = Alarm(timeline, self._look)
        if has_peer:
            self._report_alarm.set(self._receiver.due_s)

    def _soon_s(self) -> float:
        return self._timeline.now_s + self._random.random()

    # -- observe

    def observe(self, now_s: float) -> Observation:
        """Return the observation of one tick."""
        reports, self._reports = tuple(self._reports), []
        return Observation(
            now_s=now_s,
            counters=self._counters(),
            reports=reports,
            publishers=tuple(
                state for node in self._nodes if now_s - node.announced_at_s <= SILENT_S for state in node.announced
            ),
            memory=MemoryState(total_bytes=4 * 2**30, available_bytes=2 * 2**30),
            sensing_topics=self._counts[Direction.SENSING],
            actuation_topics=self._counts[Direction.ACTUATION],
            peers=None if self._has_peer else 0,
            peer_ages_s={_PEER: now_s - self._reported_s} if now_s - self._reported_s <= FORGOTTEN_S else {},
            relay=self._relay,
        )

    def _counters(self) -> LinkCounters:
        up, down = self._up, self._down
        return LinkCounters(
            interface="sim0",
            rx_bytes=int(down.received_bytes()),
            tx_bytes=int(up.sent_bytes),
            backlog_bytes=int(up.backlog_bytes),
            rx_packets=down.received_packets,
            tx_packets=up.sent_packets,
            tx_dropped=up.dropped_packets,
            state=InterfaceState.UP,
        )

    # -- act

    def set_price(self, price: Price) -> None:
        """Send the price to every publisher; best effort, as on the real topic."""
        for node in self._nodes:
            node.there.send(_PRICE_BYTES, 1, partial(self._on_price, node, price))

    def apply(self, plan: QosPlan, *, lease_s: float, missing: Collection[str], now_s: float) -> None:
        """Send a new plan at once, and an unconfirmed one again after a while."""
        is_newer = plan.generation > self._asked_generation
        if not missing or (not is_newer and now_s - self._asked_at_s < _AGAIN_S):
            return
        self._asked_generation, self._asked_at_s = plan.generation, now_s
        for node in self._nodes:
            node.there.send(_PLAN_BYTES, 1, partial(self._on_plan, node, plan, lease_s))

    def stand_by(self) -> None:
        """Do nothing: no other daemon is simulated."""

    def probe(self, request: ProbeRequest) -> None:
        """Send one train or ping over the link."""
        wire_bytes = probe_wire_bytes(request.packet_bytes)
        for index in range(request.packets):
            sent_s = self._timeline.now_s + index * _PROBE_SPACING_S
            arrive = partial(self._on_probe, request, index, sent_s) if self._has_peer else lambda: None
            self._timeline.at(sent_s, partial(self._up.send, wire_bytes, 1, arrive))

    # -- on the nodes

    def _on_price(self, node: _Node, price: Price) -> None:
        node.price, node.price_at_s = price, self._timeline.now_s
        for publisher in node.publishers:
            publisher.set_price(price)

    def _on_plan(self, node: _Node, plan: QosPlan, lease_s: float) -> None:
        node.generation, node.lease_s = plan.generation, lease_s
        for publisher in node.publishers:
            if (row := plan.topics.get(publisher.name)) is not None:
                publisher.retune(row)

    def _tell(self, node: _Node) -> None:
        now_s = self._timeline.now_s
        if node.price is not None and now_s - node.price_at_s > _SILENT_S:
            for publisher in node.publishers:
                publisher.set_price(replace(node.price, is_stale=True))
        states = tuple(
            replace(publisher.state(), generation=node.generation, lease_s=node.lease_s)
            for publisher in node.publishers
        )
        node.back.send(_SNAPSHOT_BYTES, 1, partial(self._on_snapshot, node, states))

    def _on_snapshot(self, node: _Node, states: tuple[PublisherState, ...]) -> None:
        now_s = node.announced_at_s = self._timeline.now_s
        node.announced = tuple(replace(state, announced_at_s=now_s) for state in states)

    def _summarise(self, end: SimulatedEnd) -> None:
        self._relay = RelaySummary(other_host="base", is_reachable=True, link_bytes=end.queue.link_bytes)

    # -- on the peer

    def _on_probe(self, request: ProbeRequest, index: int, sent_s: float) -> None:
        # One thread stamps the packets, late and in order.
        stamp_s = self._timeline.now_s + self._random.expovariate(1.0 / _STAMP_JITTER_S)
        self._stamp_s = max(stamp_s, self._stamp_s)
        self._receiver.on_probe(
            ProbeHeader(request.number, index, request.packets, request.quiet_s),
            request.packet_bytes,
            sent_ns=round(sent_s * 1e9),
            received_ns=round((self._stamp_s + _PEER_CLOCK_S) * 1e9),
        )
        self._report_alarm.set_by(self._receiver.due_s)

    def _look(self) -> None:
        """Send a report if one is due, as `arpd.ros.peer` does."""
        now_s, up = self._timeline.now_s, self._up
        other = sum(flow.offered_bytes(now_s) for flow in self._into_peer)
        counted = int(up.received_bytes() + other), up.received_packets + int(other / FRAME_BYTES)
        if report := self._receiver.look(now_s, counted):
            self.report_bytes += _REPORT_BYTES
            self._down.send(_REPORT_BYTES, 1, partial(self._on_report, report, now_s))
        self._report_alarm.set(self._receiver.due_s)

    def _on_report(self, report: PeerReport, sent_s: float) -> None:
        now_s = self._reported_s = self._timeline.now_s
        self._reports.append(replace(report, received_at_s=now_s, return_delay_s=now_s - (sent_s + _PEER_CLOCK_S)))
        self._on_report_arrived()
