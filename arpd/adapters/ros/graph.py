"""Which topics really cross the link, and who is there to speak of them, read from the live ROS graph."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import NameValidationException

from arpd.adapters.ros.bounds import LEAST_DEADLINE_NS
from arpd.adapters.ros.names import (
    GATE_TOPIC,
    INFINITE_NS,
    PUBLISHERS_TOPIC,
    READERS_TOPIC,
    REPORT_TOPIC,
    is_full_name,
    is_internal,
)
from arpd.model.endpoints import Direction
from arpd.model.plan import is_kept

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rclpy.node import Node

    from arpd.adapters.ros.rmw import Rmw

log = logging.getLogger(__name__)
# What rmw_dds_common says of an endpoint whose participant has not told its nodes, yet or ever.
_UNNAMED = frozenset({"_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_"})
_MOST_TOPICS = 3000  # looked at each second; who fills the graph with topics must not keep us busy with them


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """One writer or reader: its host, its participant, its deadline (ns, 0 = infinite), its node (empty = not told)."""

    host: bytes
    participant: bytes
    deadline_ns: int
    node: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Crossing:
    """How one topic crosses the link.

    Parameters
    ----------
    direction : which way; a topic with writers on both sides counts as sensing
    remote_readers : participants on the far side that read it: as many unicast copies
    requests : node and requested deadline of every reader (ns, 0 = infinite)
    offers_ns : deadlines its writers offer, each once (ns, 0 = infinite)
    writers : nodes that write it; the empty name is one that is not told
    """

    direction: Direction
    remote_readers: int
    requests: tuple[tuple[str, int], ...] = ()
    offers_ns: tuple[int, ...] = ()
    writers: frozenset[str] = frozenset()

    def tightest_request_ns(self, *, besides: Collection[str] = ()) -> int:
        """Return the tightest deadline a reader of another node than these requests, 0 = none does (ns).

        A request that nothing keeps binds nobody: its reader stays alone.
        """
        return min((ns for node, ns in self.requests if ns >= LEAST_DEADLINE_NS and node not in besides), default=0)

    def requests_of(self, node: str) -> tuple[int, ...]:
        """Return the deadlines that readers of a node request, those that no link keeps left out (ns, 0 = infinite)."""
        return tuple(ns for name, ns in self.requests if name == node and not 0 < ns < LEAST_DEADLINE_NS)

    @property
    def readers(self) -> frozenset[str]:
        """Nodes that read it; the empty name is one that is not told."""
        return frozenset(node for node, _ in self.requests)


@dataclass(frozen=True, kw_only=True, slots=True)
class Graph:
    """The ROS graph at one moment, as far as it concerns arpd.

    Parameters
    ----------
    crossings : how every topic of the robot crosses the link
    announcers, reader_announcers : nodes that could announce publishers, and readers; the empty name is one not told
    peers : writers of receiver reports
    """

    crossings: Mapping[str, Crossing]
    announcers: frozenset[str]
    reader_announcers: frozenset[str]
    peers: int

    def shows_writer(self, node: str, topic: str) -> bool:
        """Whether a node may announce a publisher of the topic, and writes it."""
        crossing = self.crossings.get(topic)
        return crossing is not None and is_among(node, crossing.writers) and is_among(node, self.announcers)

    def shows_reader(self, node: str, topic: str) -> bool:
        """Whether a node may announce a reader of the topic, and reads it."""
        crossing = self.crossings.get(topic)
        return crossing is not None and is_among(node, crossing.readers) and is_among(node, self.reader_announcers)


def is_among(node: str, nodes: Collection[str]) -> bool:
    """Whether a node is one of these, or may be: endpoints whose nodes are not told could be anybody's."""
    return node in nodes or "" in nodes


def crossing(*, robot_host: bytes, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Tell how a topic crosses, from where its endpoints live: pure."""
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
        direction = Direction.LOCAL  # between two other hosts: not over the robot's link
    return Crossing(
        direction=direction,
        remote_readers=len(remote) if direction is not Direction.LOCAL else 0,
        requests=_requests(readers),
        offers_ns=_offers_ns(writers),
        writers=_nodes(writers),
    )


def crossing_without_hosts(*, writers: Iterable[Endpoint], readers: Iterable[Endpoint]) -> Crossing:
    """Tell how a topic crosses where the middleware does not say which host an endpoint lives on: pure.

    A reader in another process than any writer may be across the link. Such a topic counts as sensing and as one copy:
    a topic wrongly planned for only gets a rate, one wrongly left out is neither paced nor gated, and copies that
    are not there would take rate from everybody.
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
    """Return how every topic of the graph crosses the link; what belongs to ROS or to arpd itself is left out.

    Fast DDS GUIDs carry the host in bytes 2-3 ; the robot's own host is that of this node's writer.

    Parameters
    ----------
    first : topics that are looked at before all others, should there be too many
    """
    own = [info for info in node.get_publishers_info_by_topic(GATE_TOPIC) if info.node_name == node.get_name()]
    robot_host = _endpoint(own[0]).host if own else b""
    tell = partial(crossing, robot_host=robot_host) if rmw.tells_hosts else crossing_without_hosts
    topics = [topic for topic, _ in node.get_topic_names_and_types() if not is_internal(topic) and is_full_name(topic)]
    topics.sort(key=lambda topic: topic not in first)
    own_name = node.get_fully_qualified_name()
    found = {topic: _read(node, topic, tell, own_name) for topic in topics[:_MOST_TOPICS]}
    return {topic: crossed for topic, crossed in found.items() if crossed is not None}


def read_graph(node: Any, rmw: Rmw, *, first: Collection[str]) -> Graph:
    """Return what the graph holds now: `read_crossings`, and who may speak of them."""
    return Graph(
        crossings=read_crossings(node, rmw, first=first),
        announcers=_nodes(map(_endpoint, node.get_publishers_info_by_topic(PUBLISHERS_TOPIC))),
        reader_announcers=_nodes(map(_endpoint, node.get_publishers_info_by_topic(READERS_TOPIC))),
        peers=node.count_publishers(REPORT_TOPIC),
    )


def _read(node: Any, topic: str, tell: Callable[..., Crossing], own_name: str) -> Crossing | None:
    """Return how one topic crosses, None where the graph has a name or a QoS in it that ROS cannot express.

    What daemons write to a topic that is everybody's, /diagnostics, is no traffic of the robot's.
    """
    try:
        written = node.get_publishers_info_by_topic(topic)
        return tell(
            writers=[_endpoint(info) for info in written if node_name_of(info) != own_name],
            readers=map(_endpoint, node.get_subscriptions_info_by_topic(topic)),
        )
    except (ValueError, NameValidationException) as fault:
        log.debug("%s left out: %s", topic, fault)
        return None


def deadline_ns_of(qos: Any) -> int:
    """Return the deadline of a QoS profile in ns, 0 for infinite (rclpy says 2^63-1 or 0 for it)."""
    nanoseconds = int(qos.deadline.nanoseconds)
    return 0 if nanoseconds >= INFINITE_NS else nanoseconds


def node_name_of(info: Any) -> str:
    """Return the fully qualified name of an endpoint's node."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def type_name_of(msg_type: Any) -> str:
    """Return the ROS name of a message class, ``sensor_msgs/msg/LaserScan``."""
    package = msg_type.__module__.split(".")[0]
    return f"{package}/msg/{msg_type.__name__}"


def _endpoint(info: Any) -> Endpoint:
    gid = bytes(info.endpoint_gid)
    return Endpoint(
        host=gid[2:4],
        participant=gid[:12],
        deadline_ns=deadline_ns_of(info.qos_profile),
        node="" if info.node_name in _UNNAMED else node_name_of(info),
    )


def _requests(readers: Iterable[Endpoint]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((reader.node, reader.deadline_ns) for reader in readers))


def _offers_ns(writers: Iterable[Endpoint]) -> tuple[int, ...]:
    return tuple(sorted({writer.deadline_ns for writer in writers}))


def _nodes(endpoints: Iterable[Endpoint]) -> frozenset[str]:
    return frozenset(endpoint.node for endpoint in endpoints)


class Requests:
    """The deadlines that readers of a topic request.

    Parameters
    ----------
    node : any node; it sees the whole graph
    topic : fully qualified topic name
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic

    def tightest_ns(self) -> int:
        """Return the shortest, 0 = none is requested (ns)."""
        return min((request for _, request in self._all() if request), default=0)

    def names(self) -> list[str]:
        """Name the nodes that read the topic."""
        return sorted(name for name, _ in self._all())

    def lost(self, *, offered_ns: int, offer_ns: int) -> list[str]:
        """Name the readers that hear a writer with the one deadline and would not hear one with the other (ns)."""
        return sorted(
            f"{name} requests {request} ns"
            for name, request in self._all()
            if is_kept(offered_ns, request) and not is_kept(offer_ns, request)
        )

    def _all(self) -> Iterator[tuple[str, int]]:
        for reader in self._node.get_subscriptions_info_by_topic(self._topic):
            yield node_name_of(reader), deadline_ns_of(reader.qos_profile)
