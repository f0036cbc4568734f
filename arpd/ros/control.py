"""The daemon's ROS side: what it observes and how it acts, behind one node."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64, UInt8MultiArray

from arpd.host.counters import InterfaceReader, read_memory
from arpd.host.radio import Radio
from arpd.model import Direction, Observation, PublisherState
from arpd.readers import ReaderState
from arpd.ros import report as wire_format
from arpd.ros.announce import from_status, reader_from_status
from arpd.ros.daemons import Daemons
from arpd.ros.graph import Crossing, read_crossings
from arpd.ros.names import GATE_TOPIC, PROBE_TOPIC, PUBLISHERS_TOPIC, READERS_TOPIC, REPORT_TOPIC
from arpd.ros.parameters import ParameterApplier
from arpd.ros.rmw import current_rmw
from arpd.wire import probe_wire_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from arpd.model import Transition
    from arpd.probing import PeerReport, ProbeRequest
    from arpd.ros.rmw import Rmw
    from arpd.settings import GraphSettings

log = logging.getLogger(__name__)

_GRAPH_S = 1.0
_RADIO_S = 1.0
_STALE_S = 3.5  # three announcements missed: the publisher is gone
_READER_STALE_S = 10.0  # the same of a reader, which repeats itself every three seconds
_PEER_FORGOTTEN_S = 60.0  # long enough for a scrape or two to see its age grow
_MOST_PEERS = 100
_MOST_ENDPOINTS = 2000  # more than any robot has; a liar on the network cannot take our memory

S = TypeVar("S", PublisherState, ReaderState)


class RosControl:
    """Observes the link, the graph and the publishers; carries out gate, plan and probes.

    Parameters
    ----------
    node : rclpy node; somebody else spins it
    interface : the robot's link interface
    graph : pinned topic counts
    on_report : called when a peer report arrives, so that a tick can follow at once
    rmw : the middleware; this process's own when None
    """

    def __init__(
        self,
        node: Any,
        *,
        interface: str,
        graph: GraphSettings,
        on_report: Callable[[], None],
        clock: Callable[[], float] = time.monotonic,
        rmw: Rmw | None = None,
    ) -> None:
        self._node = node
        self._rmw = rmw or current_rmw()
        if self._rmw.refusal:
            log.warning("%s", self._rmw.refusal)
        self._reader = InterfaceReader(interface)
        self._radio = Radio()
        self._radio_rate: float | None = None
        self._graph_settings = graph
        self._on_report_arrived = on_report
        self._clock = clock
        self._lock = threading.Lock()
        self._reports: list[PeerReport] = []
        self._peers_heard: dict[str, float] = {}  # when each reported last (s)
        self._announced: _Announced[PublisherState] = _Announced(_STALE_S)
        self._readers: _Announced[ReaderState] = _Announced(_READER_STALE_S)
        self._crossings: Mapping[str, Crossing] = {}
        self._peers: int | None = None
        self._probes = 0
        self._probe_bytes = 0
        best_effort = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._gate_publisher = node.create_publisher(Float64, GATE_TOPIC, newest)
        self._probe_publisher = node.create_publisher(UInt8MultiArray, PROBE_TOPIC, best_effort)
        node.create_subscription(UInt8MultiArray, REPORT_TOPIC, self._on_report, best_effort)
        node.create_subscription(DiagnosticArray, PUBLISHERS_TOPIC, self._on_publishers, best_effort)
        node.create_subscription(DiagnosticArray, READERS_TOPIC, self._on_readers, best_effort)
        # Steady time: when this host's clock is set back, both go on. Neither is done in the tick, which is short.
        steady, group = Clock(clock_type=ClockType.STEADY_TIME), ReentrantCallbackGroup()
        node.create_timer(_GRAPH_S, self._read_graph, callback_group=group, clock=steady)
        node.create_timer(_RADIO_S, self._read_radio, callback_group=group, clock=steady)
        self._applier = ParameterApplier(node)
        self._daemons = Daemons(node, clock=clock)

    def reconfigure(self, graph: GraphSettings) -> None:
        """Take new pinned topic counts."""
        self._graph_settings = graph

    # -- observe

    def observe(self, now_s: float) -> Observation:
        """Return everything one tick sees."""
        with self._lock:
            reports, self._reports = tuple(self._reports), []
            self._peers_heard = {
                peer: at_s for peer, at_s in self._peers_heard.items() if now_s - at_s <= _PEER_FORGOTTEN_S
            }
            peer_ages_s = {peer: max(0.0, now_s - at_s) for peer, at_s in sorted(self._peers_heard.items())}
            publishers, readers = self._announced.live(now_s), self._readers.live(now_s)
        crossings = self._crossings
        pinned = self._graph_settings
        directions = [crossing.direction for crossing in crossings.values()]
        sensing, actuation = directions.count(Direction.SENSING), directions.count(Direction.ACTUATION)
        return Observation(
            now_s=now_s,
            counters=self._reader.read(),
            reports=reports,
            publishers=_join_publishers(publishers, readers, crossings),
            readers=_join_readers(readers, crossings),
            memory=read_memory(),
            sensing_topics=sensing if pinned.sensing_topics is None else pinned.sensing_topics,
            actuation_topics=actuation if pinned.actuation_topics is None else pinned.actuation_topics,
            peers=self._peers,
            rmw=self._rmw.name,
            rmw_refusal=self._rmw.refusal,
            other_daemons=self._daemons.others(),
            superior=self._daemons.superior(),
            radio_bytes_per_second=self._radio_rate,
            peer_ages_s=MappingProxyType(peer_ages_s),
        )

    # -- act

    def set_gate(self, gate: float) -> None:
        """Tell every publisher the gate; said at every tick, so that a lost message matters for one tick only."""
        self._gate_publisher.publish(Float64(data=gate))

    def apply(self, transitions: Iterable[Transition], *, now_s: float) -> None:
        """Set parameters on the nodes of a plan; returns at once."""
        self._applier.apply(transitions, now_s=now_s)

    def probe(self, request: ProbeRequest) -> None:
        """Put one train (or ping) on the link, back to back."""
        packets = [
            wire_format.encode_probe(
                wire_format.ProbeHeader(
                    train=request.number, index=index, packets=request.packets, quiet_s=request.quiet_s
                ),
                payload_bytes=request.packet_bytes,
            )
            for index in range(request.packets)
        ]
        for packet in packets:
            self._probe_publisher.publish(packet)
        self._probes += 1
        self._probe_bytes += sum(probe_wire_bytes(len(packet.data)) for packet in packets)

    def results(self) -> Mapping[str, int]:
        """Count parameter calls by result."""
        return self._applier.results

    def probes_sent(self) -> tuple[int, int]:
        """Count probes, and their wire bytes."""
        return self._probes, self._probe_bytes

    # -- what arrives

    def _on_report(self, message: Any) -> None:
        try:
            report = wire_format.decode_report(message, received_at_s=self._clock())
        except ValueError as fault:
            log.debug("ignored a peer report: %s", fault)
            return
        with self._lock:
            self._reports.append(report)
            del self._reports[:-100]
            if report.peer in self._peers_heard or len(self._peers_heard) < _MOST_PEERS:
                self._peers_heard[report.peer] = report.received_at_s
        self._on_report_arrived()

    def _on_publishers(self, message: Any) -> None:
        self._hear(message, from_status, self._announced)

    def _on_readers(self, message: Any) -> None:
        self._hear(message, reader_from_status, self._readers)

    def _hear(self, message: Any, decode: Callable[[Any], S], heard: _Announced[S]) -> None:
        now_s = self._clock()
        for status in message.status:
            try:
                state = decode(status)
            except ValueError as fault:
                log.debug("ignored an announcement: %s", fault)
                continue
            with self._lock:
                heard.note(state, now_s)

    def _read_graph(self) -> None:
        self._crossings = read_crossings(self._node, self._rmw)
        self._peers = self._node.count_publishers(REPORT_TOPIC)

    def _read_radio(self) -> None:
        self._radio_rate = self._radio.read(self._reader.name, self._reader.index)


class _Announced(Generic[S]):
    """The last announcement of every live endpoint."""

    def __init__(self, stale_s: float) -> None:
        self._stale_s = stale_s
        self._states: dict[tuple[str, str], tuple[float, S]] = {}

    def note(self, state: S, now_s: float) -> None:
        key = state.node, state.topic
        if key in self._states or len(self._states) < _MOST_ENDPOINTS:
            self._states[key] = now_s, state

    def live(self, now_s: float) -> list[S]:
        """Return who announced itself lately, with the age of that (s), sorted by node and topic."""
        self._states = {key: (at_s, s) for key, (at_s, s) in self._states.items() if now_s - at_s <= self._stale_s}
        return [replace(state, age_s=now_s - at_s) for _, (at_s, state) in sorted(self._states.items())]


def _join_publishers(
    publishers: Iterable[PublisherState], readers: Iterable[ReaderState], crossings: Mapping[str, Crossing]
) -> tuple[PublisherState, ...]:
    driven: dict[str, set[str]] = {}
    for reader in readers:
        if reader.is_driven:
            driven.setdefault(reader.topic, set()).add(reader.node)
    return tuple(
        replace(
            state,
            direction=crossing.direction,
            remote_readers=crossing.remote_readers,
            requested_deadline_ns=crossing.tightest_request_ns(besides=driven.get(state.topic, ())),
        )
        if (crossing := crossings.get(state.topic)) is not None
        else state
        for state in publishers
    )


def _join_readers(readers: Iterable[ReaderState], crossings: Mapping[str, Crossing]) -> tuple[ReaderState, ...]:
    return tuple(
        replace(state, requests_ns=crossing.requests_of(state.node), offers_ns=crossing.offers_ns)
        if (crossing := crossings.get(state.topic)) is not None
        else state
        for state in readers
    )
