"""The daemon's ROS side: it observes and acts through one node."""

from __future__ import annotations

import logging
import math
import secrets
import threading
import time
from itertools import chain, repeat
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.estimate.peer_clocks import PeerClocks
from arpd.host.interface import InterfaceReader, MemoryReader, read_speed
from arpd.host.netlink import read_backlog
from arpd.host.radio import Radio
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.observation import Glance, MemoryState, MessageKind, MessageRefusal, Observation, Taken
from arpd.model.probing import PeerReport, ProbeRequest
from arpd.model.wire import probe_wire_bytes
from arpd.ros.crossing import Graph, read_graph
from arpd.ros.events import InvalidHandle
from arpd.ros.graph_view import GraphView
from arpd.ros.listeners import NodeSnapshots, OtherDaemons
from arpd.ros.names import PRICE_TOPIC, PROBE_TOPIC, REPORT_TOPIC
from arpd.ros.nodes import SILENT_S, Nodes
from arpd.ros.peer_reports import Ceiling, PeerAdmission
from arpd.ros.plan_sender import PlanSender
from arpd.ros.price_message import encode_price
from arpd.ros.probe_messages import MOST_REPORT_BYTES, ProbeHeader, decode_report, encode_probe
from arpd.ros.raw_reader import RawReader, ReadingThread, octets
from arpd.ros.rcl import rcl
from arpd.ros.refused_messages import RefusedMessages
from arpd.ros.rmw import Rmw, current_rmw

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from arpd.model.plan import QosPlan
    from arpd.model.price import Price
    from arpd.model.settings import GraphSettings
    from arpd.ros.raw_reader import Sample

log = logging.getLogger(__name__)
_LOOK_AROUND_S = 1.0
_MEMORY_S = 0.5  # between two readings
_JOIN_S_PER_PUBLISHER = 1e-3  # between two lists of all endpoints: of a thousand, some change at any moment
_PEER_FORGOTTEN_S = 60.0  # a scrape or two must see its age grow
_MOST_REPORTS = 200  # waiting for a tick
_WHY = {
    MessageRefusal.UNANSWERED: "they answer no probe of this daemon",
    MessageRefusal.RATE: "there are more of them than any peer sends",
    MessageRefusal.QUOTA: "the graph shows fewer peers than there are names",
}


class RosControl:
    """Observes the link, the graph and the endpoints; sends the price, and carries out plans and probes.

    Messages are read in the thread of the node's participant (`ReadingThread.of`), and nobody needs to spin the node.

    Parameters
    ----------
    node : rclpy node
    interface : the robot's link interface
    graph : pinned topic counts
    on_report : called when a peer report arrives, so that a tick can follow at once
    has_two_ends : whether a relay with two ends is configured, whose end on this host tells of it
    rmw : the middleware; this process's own when None
    randomness : gives the first number of a probe

    Attributes
    ----------
    thread : reads what arrives
    """

    def __init__(
        self,
        node: Any,
        *,
        interface: str,
        graph: GraphSettings,
        on_report: Callable[[], None],
        has_two_ends: bool = False,
        clock: Callable[[], float] = time.monotonic,
        rmw: Rmw | None = None,
        randomness: Callable[[int], int] = secrets.randbelow,
    ) -> None:
        self._node = node
        self._domain = node.context.get_domain_id()
        self._rmw = rmw or current_rmw()
        if self._rmw.refusal:
            log.warning("%s", self._rmw.refusal)
        # At debug level, because the decision log says it too.
        self._reader = InterfaceReader(interface, note=lambda _level, words: log.debug("%s", words))
        self._radio = Radio()
        self._memory = MemoryReader()
        self._memory_read: tuple[float, MemoryState | None] = (-math.inf, None)
        self._radio_rate: float | None = None
        self._graph_settings = graph
        self._on_report_arrived = on_report
        self._clock = clock
        self._lock = threading.Lock()
        self._refused = RefusedMessages(clock=clock)
        self._peer_admission = PeerAdmission(randomness(2**32))
        self._ceiling = Ceiling()
        self._reports: list[PeerReport] = []
        self._peers_heard: dict[str, float] = {}  # when each reported last (s)
        self._peer_clocks = PeerClocks()
        self._view = GraphView.of(node)
        self._changes = -1  # of the graph, when it was read last
        self._graph = Graph()
        self._crossing_counts = (0, 0)  # topics from the robot, and to it
        self._fields_of = self._graph.fields_of  # the same object until the graph changes
        self._endpoints: tuple[PublisherState, ...] = ()
        self._endpoints_until_s = -math.inf
        self._probes = 0
        self._probe_bytes = 0
        best_effort = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        newest = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
        self._price_publisher = node.create_publisher(Float64MultiArray, PRICE_TOPIC, newest)
        self._probe_publisher = node.create_publisher(UInt8MultiArray, PROBE_TOPIC, best_effort)
        self.thread = ReadingThread.of(node.context)
        shared: dict[str, Any] = {"thread": self.thread, "refused": self._refused, "clock": clock}
        self._snapshots = NodeSnapshots(node, **shared)
        self._nodes = Nodes()  # of the thread that ticks
        self._shows_writer: Callable[[str, str], bool] | None = None  # in the graph that the nodes have not seen yet
        RawReader(
            node,
            UInt8MultiArray,
            REPORT_TOPIC,
            best_effort,
            deliver=self._on_report,
            thread=self.thread,
            most_bytes=MOST_REPORT_BYTES,
            refuse=lambda: self._refuse_report(MessageRefusal.SIZE, "", "a message is longer than any report"),
        )
        self._sender = PlanSender(node)
        own = rcl().gid_of(self._price_publisher.handle)
        self._daemons = OtherDaemons(node, own, tells_hosts=self._rmw.tells_hosts, **shared)
        self._has_two_ends = has_two_ends
        self._began_s = clock()
        # In a thread: the tick must stay short, and so must the reading of messages.
        PeriodicThread(node, self._read_graph, self._read_radio, every_s=_LOOK_AROUND_S)

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
            peer_clocks = self._peer_clocks.offsets(now_s)
        self._snapshots.drain(self._nodes)
        if (shows_writer := self._shows_writer) is not None:
            self._shows_writer = None
            self._nodes.see(shows_writer)
        graph = self._graph
        publishers = self._join(now_s)
        pinned = self._graph_settings
        relay = self._nodes.relay(now_s) if self._has_two_ends else None
        sensing, actuation = self._crossing_counts
        return Observation(
            now_s=now_s,
            counters=self._reader.read(),
            reports=reports,
            publishers=publishers,
            memory=self._memory_state(now_s),
            sensing_topics=sensing if pinned.sensing_topics is None else pinned.sensing_topics,
            actuation_topics=actuation if pinned.actuation_topics is None else pinned.actuation_topics,
            peers=graph.peers,
            rmw=self._rmw.name,
            rmw_refusal=self._rmw.refusal,
            other_daemons=self._daemons.others,
            active_daemon=self._daemons.active_daemon(),
            radio_bytes_per_second=self._radio_rate,
            peer_ages_s=MappingProxyType(peer_ages_s),
            peer_clocks=MappingProxyType(peer_clocks),
            taken=Taken(refused=self._refused.counts, pending=self._nodes.pending),
            relay=relay,
            is_relay_silent=self._has_two_ends and relay is None and now_s - self._began_s > SILENT_S,
            domain=self._domain,
            remote_participants=graph.remote_participants,
        )

    def glance(self) -> Glance:
        """Return what shows whether a tick is worth its cost."""
        queue = None if self._reader.index is None else read_backlog(self._reader.index)
        return Glance(has_reports=bool(self._reports), backlog_bytes=queue.waiting_bytes if queue else None)

    def _memory_state(self, now_s: float) -> MemoryState:
        read_s, state = self._memory_read
        if state is None or now_s - read_s >= _MEMORY_S:
            state = self._memory.read()
            self._memory_read = now_s, state
        return state

    def _join(self, now_s: float) -> tuple[PublisherState, ...]:
        """Return the live publishers with what the graph shows of them; what did not change is not made again."""
        if now_s >= self._endpoints_until_s:
            self._endpoints = self._nodes.live(now_s, self._fields_of)
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
        with self._lock:
            number = self._peer_admission.number(request.number)
        packets = [
            encode_probe(
                ProbeHeader(train=number, index=index, packets=request.packets, quiet_s=request.quiet_s),
                payload_bytes=request.packet_bytes,
            )
            for index in range(request.packets)
        ]
        for packet in packets:
            self._probe_publisher.publish(packet)
        self._probes += 1
        self._probe_bytes += sum(probe_wire_bytes(len(packet.data)) for packet in packets)

    def results(self) -> Mapping[str, int]:
        """Count the answers of nodes to plans, by result."""
        return self._sender.results

    def probes_sent(self) -> tuple[int, int]:
        """Count probes, and their wire bytes."""
        return self._probes, self._probe_bytes

    # -- what arrives

    def _on_report(self, sample: Sample) -> None:
        now_s = self._clock()
        return_delay_s = (sample.received_ns - sample.sent_ns) / 1e9
        try:
            report = decode_report(octets(sample.data), received_at_s=now_s, return_delay_s=return_delay_s)
        except ValueError as fault:
            self._refuse_report(MessageRefusal.MALFORMED, "", str(fault))
            return
        with self._lock:
            believed = self._peer_admission.check(report, now_s, ceiling=self._ceiling.bytes_per_second)
            if isinstance(believed, PeerReport):
                self._reports.append(believed)
                del self._reports[:-_MOST_REPORTS]
                self._peers_heard[report.peer] = now_s
                self._peer_clocks.note(believed)
        if isinstance(believed, MessageRefusal):
            self._refuse_report(believed, report.peer, f"reports of {report.peer!r}: {_WHY[believed]}")
        else:
            self._on_report_arrived()

    def _refuse_report(self, reason: MessageRefusal, peer: str, words: str) -> None:
        self._refused.note(MessageKind.REPORTS, reason, words, source=peer)

    def _read_graph(self) -> None:
        if (changes := self._view.look()) != self._changes:
            graph = read_graph(self._view, self._rmw, first=self._nodes.topics)
            self._changes = changes
            if graph != self._graph:
                directions = [crossing.direction for crossing in graph.crossings.values()]
                self._crossing_counts = directions.count(Direction.SENSING), directions.count(Direction.ACTUATION)
                self._graph, self._fields_of = graph, graph.fields_of
        graph = self._graph
        with self._lock:
            self._peer_admission.see(graph.peers or 0)
        self._shows_writer = graph.shows_writer
        self._daemons.see(self._view.writers(PRICE_TOPIC))

    def _read_radio(self) -> None:
        self._radio_rate = self._radio.read(self._reader.name, self._reader.index)
        with self._lock:
            self._ceiling.note(self._clock(), interface=read_speed(self._reader.name), radio=self._radio_rate)


_RESTS, _MOST_REST_S = 10.0, 3.0  # times the duration of a turn; and at most, in case something else held it up
_FAST_TURNS = 30  # at the start the graph changes quickly


class PeriodicThread:
    """Does its tasks again and again, until the node is destroyed or its context ends.

    Parameters
    ----------
    node : rclpy node that the tasks use
    tasks : called one after the other; a task that raises is logged, and the others go on
    every_s : time between two turns, at first a fifth of it; longer after turns that take long (s)
    """

    def __init__(self, node: Any, *tasks: Callable[[], None], every_s: float) -> None:
        self._node = node
        self._tasks = tasks
        self._every_s = every_s
        threading.Thread(target=self._run, name="arpd-periodic", daemon=True).start()

    def _run(self) -> None:
        for pause_s in chain(repeat(self._every_s / 5, _FAST_TURNS), repeat(self._every_s)):
            if not self._node.context.ok():
                return
            began_s = time.monotonic()
            for task in self._tasks:
                try:
                    task()
                except InvalidHandle:
                    return
                except Exception:
                    log.exception("a periodic task failed; it runs again, and the others go on")
            time.sleep(max(pause_s, min(_MOST_REST_S, _RESTS * (time.monotonic() - began_s))))
