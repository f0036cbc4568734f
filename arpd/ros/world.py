"""The daemon's ROS side: it observes and acts through one node."""

from __future__ import annotations

import logging
import math
import secrets
import threading
import time
from collections import deque
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.host.interface import InterfaceReader, is_radio, read_memory
from arpd.host.radio import transmit_rate
from arpd.model.endpoints import MOST_PUBLISHERS, Direction, NodeSnapshot, PublisherState
from arpd.model.errors import NotKnownError
from arpd.model.observation import MessageKind, MessageRefusal, Observation
from arpd.model.probing import ProbeHeader
from arpd.ros.cdr import wrap
from arpd.ros.crossing import Graph, read_graph
from arpd.ros.graph import Endpoint, GraphView, this_host
from arpd.ros.inbox import Inbox, Letters
from arpd.ros.names import PRICE_TOPIC, PROBE_TOPIC, PUBLISHERS_TOPIC, REPORT_TOPIC
from arpd.ros.node_snapshot import LONGEST_SNAPSHOT
from arpd.ros.nodes import SILENT_S, Nodes
from arpd.ros.other_daemons import OtherDaemons
from arpd.ros.peer_reports import PeerReports
from arpd.ros.plan_sender import PlanSender
from arpd.ros.price_message import encode_price
from arpd.ros.probe_messages import MOST_REPORT_BYTES, decode_report, encode_probe
from arpd.ros.raw_reader import ReadingThread, Sample
from arpd.ros.rcl import InvalidHandle, rcl
from arpd.ros.rmw import current_rmw
from arpd.ros.snapshot_decoder import decode_snapshot

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from arpd.model.plan import QosPlan
    from arpd.model.price import Price
    from arpd.model.probing import PeerReport, ProbeRequest

log = logging.getLogger(__name__)
_LOOK_AROUND_S, _HOST_S = 0.2, 1.0  # between two looks at the graph, and at memory and radio
_JOIN_S_PER_PUBLISHER = 1e-3  # between two lists of all endpoints: of a thousand, some change at any moment
_MOST_SNAPSHOTS = 1000  # waiting for a tick
_LARGE = 4.0  # more messages that the largest snapshot counts for: it comes once a second, and takes long to read


def _weigh(snapshot: NodeSnapshot | None) -> float:
    return _LARGE if snapshot is None else _LARGE * len(snapshot.publishers) / MOST_PUBLISHERS


# Nodes send 5 a second at most, and peers 50.
_SNAPSHOTS = Letters(
    topic=PUBLISHERS_TOPIC, decode=decode_snapshot, most_bytes=LONGEST_SNAPSHOT, most_hz=8.0, weigh=_weigh
)
_REPORTS = Letters(topic=REPORT_TOPIC, decode=decode_report, most_bytes=MOST_REPORT_BYTES, most_hz=60.0)
_WHY = {
    MessageRefusal.UNANSWERED: "they answer no probe of this daemon",
    MessageRefusal.QUOTA: "the graph shows fewer peers than there are names",
}


class RosControl:
    """Observes the link, the graph and the endpoints; sends the price, and carries out plans and probes.

    Messages are read in the thread of the node's participant (`ReadingThread.of`), and nobody needs to spin the node.

    Parameters
    ----------
    interface : the robot's link interface
    on_report : called when a peer report arrives, so that a tick can follow at once
    has_two_ends : whether a relay with two ends is configured, whose end on this host tells of it
    """

    def __init__(
        self,
        node: Any,
        *,
        interface: str,
        route: Callable[[], str | None] = lambda: None,
        on_report: Callable[[], None],
        has_two_ends: bool = False,
    ) -> None:
        self._node = node
        self._domain = node.context.get_domain_id()
        self._rmw = current_rmw()
        if self._rmw.refusal:
            log.warning("%s", self._rmw.refusal)
        self._reader = InterfaceReader(interface, route=route)
        self._memory = read_memory()
        self._radio_rate: float | None = None
        self._radio_fault = ""
        self._on_report_arrived = on_report
        self._reports = PeerReports(secrets.randbelow(2**32))
        self._snapshots: deque[tuple[bytes, NodeSnapshot, float]] = deque(maxlen=_MOST_SNAPSHOTS)  # with their arrival
        self._view = GraphView.of(node)
        self._seen = (-1, frozenset[bytes]())  # changes of the graph, and hosts, when it was read last
        self._graph = Graph()  # of the thread that looks around
        self._endpoints: tuple[PublisherState, ...] = ()
        self._endpoints_until_s = -math.inf
        newest, best_effort, many = (
            QoSProfile(depth=depth, reliability=QoSReliabilityPolicy.BEST_EFFORT) for depth in (1, 100, 1000)
        )
        self._price_publisher = node.create_publisher(Float64MultiArray, PRICE_TOPIC, newest)
        self._probe_publisher = node.create_publisher(UInt8MultiArray, PROBE_TOPIC, best_effort)
        self.thread = ReadingThread.of(node.context)
        self._nodes = Nodes()  # of the thread that ticks
        self._sender = PlanSender(node)
        own = rcl().gid_of(self._price_publisher.handle)
        self._daemons = OtherDaemons(node, own, tells_hosts=self._rmw.tells_hosts)
        self._inboxes: dict[MessageKind, Inbox[Any]] = {
            MessageKind.PUBLISHERS: Inbox(node, _SNAPSHOTS, many, self._on_snapshot),
            MessageKind.REPORTS: Inbox(node, _REPORTS, best_effort, self._on_report),
            MessageKind.PRICES: self._daemons.inbox,
        }
        # Hosts of endpoints that are this one: a node, or an end, may be older or younger than one of its addresses.
        self._here: frozenset[bytes] = frozenset()
        self._has_two_ends = has_two_ends
        self._began_s = time.monotonic()
        # The tick must stay short, and so must the reading of messages.
        threading.Thread(target=self._look_around, name="arpd-looking", daemon=True).start()

    # -- observe

    def observe(self, now_s: float) -> Observation:
        """Return everything one tick sees."""
        reports, peer_ages_s, peer_clocks = self._reports.take(now_s)
        self._take_snapshots()
        graph = self._graph
        self._nodes.see(graph)
        publishers = self._join(now_s)
        relay = self._nodes.relay(now_s) if self._has_two_ends else None
        return Observation(
            now_s=now_s,
            counters=self._reader.read(),
            reports=reports,
            publishers=publishers,
            memory=self._memory,
            sensing_topics=graph.topics[Direction.SENSING],
            actuation_topics=graph.topics[Direction.ACTUATION],
            peers=graph.peers,
            rmw=self._rmw.name,
            rmw_refusal=self._rmw.refusal,
            other_daemons=self._daemons.others,
            active_daemon=self._daemons.active_daemon(),
            radio_bytes_per_second=self._radio_rate,
            peer_ages_s=MappingProxyType(peer_ages_s),
            peer_clocks=MappingProxyType(peer_clocks),
            refused=self._refused(),
            answers=dict(self._sender.results),
            pending=self._nodes.pending,
            left_out=self._nodes.left_out,
            relay=relay,
            is_relay_silent=self._has_two_ends and relay is None and now_s - self._began_s > SILENT_S,
            domain=self._domain,
            remote_participants=graph.remote_participants,
        )

    def _join(self, now_s: float) -> tuple[PublisherState, ...]:
        """Return the live publishers with what the graph shows of them; what did not change is not made again."""
        if now_s >= self._endpoints_until_s:
            self._endpoints = self._nodes.live(now_s)
            self._endpoints_until_s = now_s + _JOIN_S_PER_PUBLISHER * len(self._endpoints)
        return self._endpoints

    # -- act

    def set_price(self, price: Price) -> None:
        """Send the price to every publisher; best effort, because the caller repeats it."""
        self._price_publisher.publish(Float64MultiArray(data=encode_price(price)))

    def apply(self, plan: QosPlan, *, lease_s: float, missing: Collection[str], now_s: float) -> None:
        """Send the plan to the nodes if some do not show it; returns at once."""
        self._sender.apply(plan, lease_s=lease_s, missing=missing, answers=self._nodes.answers, now_s=now_s)

    def stand_by(self) -> None:
        """Take back the plan that was sent: a node that starts must not find that of a daemon that stands by."""
        self._sender.forget()

    def probe(self, request: ProbeRequest) -> None:
        """Send one train, or a ping, back to back."""
        number = self._reports.number(request.number, time.monotonic())
        head, size = ProbeHeader(number, 0, request.packets, request.quiet_s), request.packet_bytes
        packets = [wrap(encode_probe(replace(head, index=k), payload_bytes=size)) for k in range(head.packets)]
        for packet in packets:
            self._probe_publisher.publish(packet)

    # -- what arrives

    def _take_snapshots(self) -> None:
        while self._snapshots:
            writer, snapshot, at_s = self._snapshots.popleft()
            if not self._nodes.note(writer, snapshot, at_s):
                words = f"too many publishers; some or all of those of {snapshot.node} are left out"
                self._inboxes[MessageKind.PUBLISHERS].refuse(MessageRefusal.QUOTA, writer, words)

    def _on_snapshot(self, sample: Sample, snapshot: NodeSnapshot) -> None:
        self._snapshots.append((sample.writer, snapshot, time.monotonic()))
        if snapshot.host and snapshot.host == this_host():
            self._here |= {Endpoint(gid=sample.writer).host}

    def _on_report(self, sample: Sample, report: PeerReport) -> None:
        return_delay_s = (sample.received_ns - sample.sent_ns) / 1e9
        report = replace(report, received_at_s=time.monotonic(), return_delay_s=return_delay_s)
        refusal = self._reports.note(report, must_answer=not self._daemons.active_daemon())
        if refusal is None:
            self._on_report_arrived()
        # A peer that starts has heard no probe yet, and one may answer a daemon that drove.
        elif refusal is not MessageRefusal.UNANSWERED or (report.last_probe and not self._daemons.are_heard):
            words = f"reports of {report.peer!r}: {_WHY[refusal]}"
            self._inboxes[MessageKind.REPORTS].refuse(refusal, sample.writer, words)

    def _refused(self) -> Mapping[tuple[MessageKind, MessageRefusal], int]:
        return {
            (kind, reason): count for kind, inbox in self._inboxes.items() for reason, count in [*inbox.refused.items()]
        }

    # -- what changes slowly

    def _look_around(self) -> None:
        """Read graph, memory and radio again and again, until the node is destroyed or its context ends."""
        due_s = -math.inf
        while self._node.context.ok():
            try:
                self._read_graph()
                if time.monotonic() >= due_s:
                    due_s = time.monotonic() + _HOST_S
                    self._memory = read_memory(self._memory)
                    self._read_radio()
            except InvalidHandle:
                return
            except Exception:
                log.exception("memory, graph or radio cannot be read; arpd tries again")
            time.sleep(_LOOK_AROUND_S)

    def _read_graph(self) -> None:
        if (seen := (self._view.look(), self._here)) == self._seen:
            return
        graph = read_graph(self._view, self._rmw, first=self._nodes.topics, here=self._here)
        self._seen = seen
        self._daemons.see(self._view.writers(PRICE_TOPIC))
        if graph != self._graph:
            self._graph = graph
            self._reports.see(graph.peers or 0)

    def _read_radio(self) -> None:
        name = self._reader.name
        try:
            self._radio_rate = transmit_rate(name) if is_radio(name) else None
        except NotKnownError as error:
            self._radio_rate = None
            if self._radio_fault != (fault := str(error)):
                self._radio_fault = fault
                log.info("%s has no known bit rate: %s; arpd goes without it", name, fault)
