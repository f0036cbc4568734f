"""Topics that cross the link, and the nodes that may announce them, read from the live ROS graph."""

from __future__ import annotations

import logging
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any
from zlib import crc32

from rclpy.exceptions import NameValidationException
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy

from arpd.adapters.ros.crossing import Crossing, Endpoint, crossing, crossing_without_hosts
from arpd.adapters.ros.names import (
    INFINITE_NS,
    PRICE_TOPIC,
    PUBLISHERS_TOPIC,
    REPORT_TOPIC,
    is_full_name,
)
from arpd.model.names import is_internal
from arpd.model.plan import is_kept

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from rclpy.node import Node

    from arpd.adapters.ros.rmw import Rmw

log = logging.getLogger(__name__)
# rmw_dds_common's names for the node of an endpoint whose participant has not named its nodes, yet or ever.
NOT_NAMED_YET = "_NODE_NAME_UNKNOWN_"
_UNNAMED = frozenset({NOT_NAMED_YET, "_CREATED_BY_BARE_DDS_APP_"})
_PARTICIPANT_BYTES = 12  # of a GUID (OMG DDSI-RTPS 2.3, 9.3.1)
_MOST_TOPICS = 3000  # looked at each second, so that a graph full of topics does not take the processor
# With 1,000 topics all nodes take 3 ms at each look, and a topic 30 µs to count or 200 µs to read.
_MOST_COUNTED = 150  # topics at a look
_LOOKS_PER_READ = 10
_MOST_READ_AGAIN = 20  # topics at a look
_MOST_NODES = 500
_EVERY_NODE_WRITES = ("/parameter_events", "/rosout")


@dataclass(frozen=True, kw_only=True, slots=True)
class Graph:
    """The part of the ROS graph that concerns arpd, at one moment.

    Parameters
    ----------
    crossings : every topic of the robot
    announcers : nodes that may announce publishers; the empty name is an unknown node
    peers : writers of receiver reports
    remote_participants : processes with ROS nodes on other hosts than the robot
    """

    crossings: Mapping[str, Crossing]
    announcers: frozenset[str]
    peers: int
    remote_participants: int = 1

    def shows_writer(self, node: str, topic: str) -> bool:
        """Return whether a node may announce a publisher of the topic, and writes it."""
        crossing = self.crossings.get(topic)
        return crossing is not None and _may_speak(node, crossing.writers, self.announcers)


def _may_speak(node: str, endpoints: Collection[str], announcers: Collection[str]) -> bool:
    """Return whether a node may have one of these endpoints, and may announce it.

    An endpoint whose node is unknown may be that of any node that the graph does not name. It stays so where a process
    returned after an outage that it did not notice: it sees no reason to name its nodes again.
    """
    if node in endpoints:
        return node in announcers or "" in announcers
    return node not in announcers and "" in announcers and "" in endpoints


@dataclass(frozen=True, kw_only=True, slots=True)
class _Known:
    """What the last reading of a topic found.

    Parameters
    ----------
    nodes : with a writer or a reader
    numbers : of writers and of readers
    is_named : True when the nodes of all of them are known
    participants : processes that write it
    """

    nodes: Sequence[str]
    numbers: tuple[int, int]
    is_named: bool
    crossing: Crossing
    participants: frozenset[bytes]


class GraphReader:
    """Reads the graph as it is now, and of that only what has changed.

    To find all endpoints of one topic, the middleware goes through those of all topics. What each node writes and reads
    costs a hundredth of that. So a topic is read again when its nodes or the numbers of its endpoints have changed,
    while the name of a node is unknown, and otherwise at every tenth look. Where there are many topics, each look
    counts and reads again only some of them: with 1,000 it may take a minute until a second writer in one node is seen,
    or a writer or reader that another one of its node replaced.

    Parameters
    ----------
    node : any node; it sees the whole graph
    """

    def __init__(self, node: Any, rmw: Rmw) -> None:
        self._node = node
        self._rmw = rmw
        self._robot_host = b""
        self._known: dict[str, _Known] = {}
        self._looks = 0

    def read(self, *, first: Collection[str] = ()) -> Graph:
        """Return the crossing of every topic, without those of ROS and of arpd itself, and who may announce them.

        Bytes 2 and 3 of a Fast DDS GUID name the host; the robot's host is that of this node's price writer.

        Parameters
        ----------
        first : topics to read first, in case there are too many
        """
        self._looks += 1
        self._find_host()
        found = [name for name, _ in self._node.get_topic_names_and_types() if not is_internal(name)]
        topics = sorted(filter(is_full_name, found), key=lambda topic: topic not in first)[:_MOST_TOPICS]
        nodes = self._nodes_by_topic()
        self._known = {
            topic: known
            for topic in (*topics, *_EVERY_NODE_WRITES, PUBLISHERS_TOPIC)
            if (known := self._look(topic, nodes.get(topic, ()))) is not None
        }
        crossed = {topic: self._known[topic].crossing for topic in topics if topic in self._known}
        return Graph(
            crossings=crossed,
            announcers=self._writers(PUBLISHERS_TOPIC),
            peers=self._node.count_publishers(REPORT_TOPIC),
            remote_participants=self._remote_participants(),
        )

    def _find_host(self) -> None:
        """Find the robot's host; all crossings depend on it."""
        if not self._robot_host:
            prices = self._node.get_publishers_info_by_topic(PRICE_TOPIC)
            own = [_endpoint(info) for info in prices if info.node_name == self._node.get_name()]
            self._robot_host = own[0].host if own else b""
            self._known.clear()

    def _remote_participants(self) -> int:
        """Count the processes on other hosts; 1 where hosts are unknown."""
        if not (self._robot_host and self._rmw.tells_hosts):
            return 1
        named = (self._known[topic].participants for topic in _EVERY_NODE_WRITES if topic in self._known)
        return sum(host_of(participant) != self._robot_host for participant in frozenset[bytes]().union(*named))

    def _writers(self, topic: str) -> frozenset[str]:
        return self._known[topic].crossing.writers if topic in self._known else frozenset()

    def _nodes_by_topic(self) -> dict[str, list[str]]:
        """Return the nodes that the graph shows with a writer or a reader, of every topic, in the graph's order."""
        nodes = defaultdict[str, list[str]](list)
        for name, namespace in self._node_names():
            try:
                written = self._node.get_publisher_names_and_types_by_node(name, namespace)
                read = self._node.get_subscriber_names_and_types_by_node(name, namespace)
            except (RuntimeError, ValueError) as fault:  # it is gone, or has what ROS cannot express
                log.debug("%s left out: %s", name, fault)
                continue
            for kind, topics in (("writes", written), ("reads", read)):
                for topic, _types in topics:
                    nodes[topic].append(f"{namespace}/{name} {kind}")
        return nodes

    def _node_names(self) -> list[tuple[str, str]]:
        """Return names and namespaces; none where one of them is no text, and topics are only counted then."""
        try:
            return [*dict.fromkeys(self._node.get_node_names_and_namespaces())][:_MOST_NODES]
        except ValueError as fault:
            log.debug("no nodes: %s", fault)
            return []

    def _look(self, topic: str, nodes: Sequence[str]) -> _Known | None:
        """Return what is known of a topic, None where the graph has a name or QoS that ROS cannot express."""
        known, turn = self._known.get(topic), self._looks + crc32(topic.encode())
        is_due = turn % max(_LOOKS_PER_READ, len(self._known) // _MOST_READ_AGAIN) == 0
        is_counted = turn % (1 + len(self._known) // _MOST_COUNTED) == 0
        try:
            if (
                known is None
                or not known.is_named
                or known.nodes != nodes
                or is_due
                or (is_counted and known.numbers != self._count(topic))
            ):
                return self._read(topic, nodes)
        except (ValueError, NameValidationException) as fault:
            log.debug("%s left out: %s", topic, fault)
            return None
        return known

    def _count(self, topic: str) -> tuple[int, int]:
        """Count its writers and its readers."""
        handle = self._node.handle
        with handle:  # Node.count_publishers would check the name again, at four times the cost
            return handle.get_count_publishers(topic), handle.get_count_subscribers(topic)

    def _read(self, topic: str, nodes: Sequence[str]) -> _Known:
        """Read the endpoints of a topic; the daemon's own writer of /diagnostics does not count as traffic."""
        numbers = self._count(topic)
        own_name = self._node.get_fully_qualified_name()
        written = self._node.get_publishers_info_by_topic(topic)
        writers = [_endpoint(info) for info in written if node_name_of(info) != own_name]
        readers = [_endpoint(info) for info in self._node.get_subscriptions_info_by_topic(topic)]
        cross = partial(crossing, robot_host=self._robot_host) if self._rmw.tells_hosts else crossing_without_hosts
        return _Known(
            nodes=nodes,
            numbers=numbers,
            is_named=all(endpoint.node for endpoint in (*writers, *readers)),
            crossing=cross(writers=writers, readers=readers),
            participants=frozenset(writer.participant for writer in writers),
        )


def deadline_ns_of(qos: Any) -> int:
    """Return the deadline of a QoS profile, 0 = infinite, for which rclpy has 2^63-1 or 0 (ns)."""
    return period_ns_of(qos.deadline)


def period_ns_of(duration: Any) -> int:
    """Return a period of a QoS profile, 0 = infinite, for which rclpy has 2^63-1 or 0 (ns)."""
    nanoseconds = int(duration.nanoseconds)
    return 0 if nanoseconds >= INFINITE_NS else nanoseconds


def policies_of(*, is_reliable: bool, is_latched: bool) -> dict[str, Any]:
    """Return reliability and durability as arguments of a QoS profile."""
    return {
        "reliability": QoSReliabilityPolicy.RELIABLE if is_reliable else QoSReliabilityPolicy.BEST_EFFORT,
        "durability": QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
    }


def node_name_of(info: Any) -> str:
    """Return the fully qualified name of an endpoint's node."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def known_node_of(info: Any) -> str:
    """Return the same, empty while the graph does not know the node, or if there is none."""
    return "" if info.node_name in _UNNAMED else node_name_of(info)


def participant_of(info: Any) -> bytes:
    """Return the first bytes of an endpoint's GUID, which name its process in the domain."""
    return bytes(info.endpoint_gid)[:_PARTICIPANT_BYTES]


def host_of(participant: bytes) -> bytes:
    """Return the part of a process's GUIDs that names its host; only Fast DDS has one."""
    return participant[2:4]


def type_name_of(msg_type: Any) -> str:
    """Return the ROS name of a message class, ``sensor_msgs/msg/LaserScan``."""
    package = msg_type.__module__.split(".")[0]
    return f"{package}/msg/{msg_type.__name__}"


def _endpoint(info: Any) -> Endpoint:
    participant = participant_of(info)
    return Endpoint(
        host=host_of(participant),
        participant=participant,
        deadline_ns=deadline_ns_of(info.qos_profile),
        node=known_node_of(info),
    )


class Requests:
    """QoS that the readers of a topic request.

    Parameters
    ----------
    node : any node; it sees the whole graph
    topic : fully qualified topic name
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic

    def tightest_ns(self) -> int:
        """Return the shortest deadline, 0 = none is requested (ns)."""
        return min((request for _, request in self._all() if request), default=0)

    def are_reliable(self) -> bool:
        """Return whether all readers are reliable."""
        readers = self._node.get_subscriptions_info_by_topic(self._topic)
        return all(reader.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE for reader in readers)

    def names(self) -> list[str]:
        """Name the nodes that read the topic."""
        return sorted(name for name, _ in self._all())

    def lost(self, *, offered_ns: int, offer_ns: int) -> list[str]:
        """Name the readers that hear a writer which offers the first deadline, and would not hear the second (ns)."""
        return sorted(
            f"{name} requests {request} ns"
            for name, request in self._all()
            if is_kept(offered_ns, request) and not is_kept(offer_ns, request)
        )

    def objection(self, *, offered_ns: int, offer_ns: int) -> str:
        """Return in words why the readers did not all match a writer that offers the second deadline (ns)."""
        if lost := self.lost(offered_ns=offered_ns, offer_ns=offer_ns):
            return f"DEADLINE {offer_ns or 'infinite'} would lose readers ({', '.join(lost)})"
        return f"not all readers matched in time (in the graph: {', '.join(self.names()) or 'none'})"

    def _all(self) -> Iterator[tuple[str, int]]:
        for reader in self._node.get_subscriptions_info_by_topic(self._topic):
            yield node_name_of(reader), deadline_ns_of(reader.qos_profile)
