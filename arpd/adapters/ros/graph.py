"""Topics that cross the link, and the nodes that may announce them, read from the live ROS graph."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import NameValidationException
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy

from arpd.adapters.ros.bounds import LEAST_DEADLINE_NS
from arpd.adapters.ros.names import (
    INFINITE_NS,
    PRICE_TOPIC,
    PUBLISHERS_TOPIC,
    READERS_TOPIC,
    REPORT_TOPIC,
    is_full_name,
)
from arpd.model.endpoints import Direction
from arpd.model.names import is_internal
from arpd.model.plan import is_kept

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rclpy.node import Node

    from arpd.adapters.ros.rmw import Rmw

log = logging.getLogger(__name__)
# rmw_dds_common's names for the node of an endpoint whose participant has not named its nodes, yet or ever.
NOT_NAMED_YET = "_NODE_NAME_UNKNOWN_"
_UNNAMED = frozenset({NOT_NAMED_YET, "_CREATED_BY_BARE_DDS_APP_"})
_PARTICIPANT_BYTES = 12  # of a GUID (OMG DDSI-RTPS 2.3, 9.3.1)
_MOST_TOPICS = 3000  # read each second, so that a graph full of topics does not take the processor


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """One writer or reader: its host, its participant, its deadline (ns, 0 = infinite), its node (empty = unknown)."""

    host: bytes
    participant: bytes
    deadline_ns: int
    node: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """Direction, readers and writers of one topic.

    Parameters
    ----------
    direction : a topic with writers on both sides counts as sensing
    remote_readers : participants across the link from a writer that read it; each receives a unicast copy
    requests : node and requested deadline of every reader (ns, 0 = infinite)
    offers_ns : deadlines its writers offer, each once (ns, 0 = infinite)
    writers : nodes that write it; the empty name is a node whose name is unknown
    """

    direction: Direction
    remote_readers: int
    requests: tuple[tuple[str, int], ...] = ()
    offers_ns: tuple[int, ...] = ()
    writers: frozenset[str] = frozenset()

    def tightest_request_ns(self, *, besides: Collection[str] = ()) -> int:
        """Return the tightest deadline requested by a reader of other nodes than these, 0 = none (ns).

        Requests that no writer can keep do not count.
        """
        return min((ns for node, ns in self.requests if ns >= LEAST_DEADLINE_NS and node not in besides), default=0)

    def requests_of(self, node: str) -> tuple[int, ...]:
        """Return the deadlines that readers of a node request, without those that no writer can keep (ns)."""
        return tuple(ns for name, ns in self.requests if name == node and not 0 < ns < LEAST_DEADLINE_NS)

    @property
    def readers(self) -> frozenset[str]:
        """Nodes that read it; the empty name is a node whose name is unknown."""
        return frozenset(node for node, _ in self.requests)


@dataclass(frozen=True, kw_only=True, slots=True)
class Graph:
    """The part of the ROS graph that concerns arpd, at one moment.

    Parameters
    ----------
    crossings : every topic of the robot
    announcers, reader_announcers : nodes that may announce publishers, and readers; the empty name is an unknown node
    peers : writers of receiver reports
    """

    crossings: Mapping[str, Crossing]
    announcers: frozenset[str]
    reader_announcers: frozenset[str]
    peers: int

    def shows_writer(self, node: str, topic: str) -> bool:
        """Return whether a node may announce a publisher of the topic, and writes it."""
        crossing = self.crossings.get(topic)
        return crossing is not None and is_among(node, crossing.writers) and is_among(node, self.announcers)

    def shows_reader(self, node: str, topic: str) -> bool:
        """Return whether a node may announce a reader of the topic, and reads it."""
        crossing = self.crossings.get(topic)
        return crossing is not None and is_among(node, crossing.readers) and is_among(node, self.reader_announcers)


def is_among(node: str, nodes: Collection[str]) -> bool:
    """Return whether a node is one of these, or may be: an endpoint with an unknown node may be anybody's."""
    return node in nodes or "" in nodes


def crossing(*, robot_host: bytes, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Return the crossing of a topic from the hosts of its endpoints: pure."""
    writers, readers = tuple(writers), tuple(readers)
    writer_hosts = {writer.host for writer in writers}
    remote = {reader.participant for reader in readers if writer_hosts - {reader.host}}
    if not remote or not writer_hosts:
        direction = Direction.LOCAL
    elif robot_host in writer_hosts:
        direction = Direction.SENSING
    elif any(reader.host == robot_host for reader in readers):
        direction = Direction.ACTUATION
    else:
        direction = Direction.LOCAL  # between two other hosts
    return Crossing(
        direction=direction,
        remote_readers=_copies(writer_hosts, readers) if direction is not Direction.LOCAL else 0,
        requests=_requests(readers),
        offers_ns=_offers_ns(writers),
        writers=_nodes(writers),
    )


def _copies(writer_hosts: Collection[bytes], readers: Collection[Endpoint]) -> int:
    """Count the copies of a sample that cross the link: with writers on both sides, those of the side with more."""
    return max(len({reader.participant for reader in readers if reader.host != host}) for host in writer_hosts)


def crossing_without_hosts(*, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Return the crossing of a topic where the middleware does not name the hosts of endpoints: pure.

    A reader in another process than any writer may be across the link. Such a topic counts as sensing, with one copy.
    To plan a local topic only gives it a rate, but to leave out a topic that crosses would leave it unpaced; and copies
    that do not exist would take rate from every topic.
    """
    writers, readers = tuple(writers), tuple(readers)
    processes = {writer.participant for writer in writers}
    is_crossing = bool(processes) and any(reader.participant not in processes for reader in readers)
    return Crossing(
        direction=Direction.SENSING if is_crossing else Direction.LOCAL,
        remote_readers=int(is_crossing),
        requests=_requests(readers),
        offers_ns=_offers_ns(writers),
        writers=_nodes(writers),
    )


def read_crossings(node: Any, rmw: Rmw, *, first: Collection[str] = ()) -> Mapping[str, Crossing]:
    """Return the crossing of every topic of the graph, without those of ROS and of arpd itself.

    Bytes 2 and 3 of a Fast DDS GUID name the host; the robot's host is that of this node's price writer.

    Parameters
    ----------
    first : topics to read first, in case there are too many
    """
    own = [info for info in node.get_publishers_info_by_topic(PRICE_TOPIC) if info.node_name == node.get_name()]
    robot_host = _endpoint(own[0]).host if own else b""
    cross = partial(crossing, robot_host=robot_host) if rmw.tells_hosts else crossing_without_hosts
    topics = [topic for topic, _ in node.get_topic_names_and_types() if not is_internal(topic) and is_full_name(topic)]
    topics.sort(key=lambda topic: topic not in first)
    own_name = node.get_fully_qualified_name()
    found = {topic: _read(node, topic, cross, own_name) for topic in topics[:_MOST_TOPICS]}
    return {topic: crossed for topic, crossed in found.items() if crossed is not None}


def read_graph(node: Any, rmw: Rmw, *, first: Collection[str]) -> Graph:
    """Return the graph as it is now: the crossings, and the nodes that may announce them."""
    return Graph(
        crossings=read_crossings(node, rmw, first=first),
        announcers=_nodes(map(_endpoint, node.get_publishers_info_by_topic(PUBLISHERS_TOPIC))),
        reader_announcers=_nodes(map(_endpoint, node.get_publishers_info_by_topic(READERS_TOPIC))),
        peers=node.count_publishers(REPORT_TOPIC),
    )


def _read(node: Any, topic: str, cross: Callable[..., Crossing], own_name: str) -> Crossing | None:
    """Return the crossing of one topic, None where the graph has a name or QoS that ROS cannot express.

    The daemon's own writer of /diagnostics does not count: it is no traffic of the robot.
    """
    try:
        written = node.get_publishers_info_by_topic(topic)
        return cross(
            writers=[_endpoint(info) for info in written if node_name_of(info) != own_name],
            readers=map(_endpoint, node.get_subscriptions_info_by_topic(topic)),
        )
    except (ValueError, NameValidationException) as fault:
        log.debug("%s left out: %s", topic, fault)
        return None


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


def _requests(readers: Iterable[Endpoint]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((reader.node, reader.deadline_ns) for reader in readers))


def _offers_ns(writers: Iterable[Endpoint]) -> tuple[int, ...]:
    return tuple(sorted({writer.deadline_ns for writer in writers}))


def _nodes(endpoints: Iterable[Endpoint]) -> frozenset[str]:
    return frozenset(endpoint.node for endpoint in endpoints)


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
