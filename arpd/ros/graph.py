"""The ROS graph as one process sees it, and the writers and readers of its topics."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSDurabilityPolicy, QoSLivelinessPolicy, QoSReliabilityPolicy

from arpd.model.plan import is_kept
from arpd.ros.names import INFINITE_NS
from arpd.ros.rcl import InvalidHandle, attached, rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rclpy.node import Node

log = logging.getLogger(__name__)
# rmw_dds_common's names for the node of an endpoint whose participant has not named its nodes, yet or ever.
_NOT_NAMED_YET = "_NODE_NAME_UNKNOWN_"
_UNNAMED = frozenset({_NOT_NAMED_YET, "_CREATED_BY_BARE_DDS_APP_"})
_HASH_BYTES = 32
ON_EVERY_NODE = "/parameter_events"  # every node of rclcpp and rclpy writes it
_RESTS = 10.0  # times as long as reading took
_MOST_REST_S = 2.0  # samples of a writer that is not known yet are held for 3
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """One writer or reader.

    Parameters
    ----------
    gid : its DDS GUID (16 bytes)
    node : fully qualified name of its node, empty = unknown
    is_named : False while its process has not told which node it belongs to; one made without ROS never does
    type_name : its type
    type_hash : of the definition of that type (REP 2016), as "RIHS01_..."; empty where its middleware tells none
    is_reliable, is_latched : its reliability and durability
    deadline_ns, lifespan_ns, lease_ns : its periods, 0 = infinite (ns)
    is_manual : whether it asserts its liveliness by topic
    """

    gid: bytes
    node: str = ""
    is_named: bool = True
    type_name: str = ""
    type_hash: str = ""
    is_reliable: bool = True
    is_latched: bool = False
    deadline_ns: int = 0
    lifespan_ns: int = 0
    lease_ns: int = 0
    is_manual: bool = False

    @property
    def participant(self) -> bytes:
        """First bytes of its GUID, which name its process in the domain."""
        return self.gid[:12]  # OMG DDSI-RTPS 2.3, 9.3.1

    @property
    def host(self) -> bytes:
        """The part of its GUID that names its host; only Fast DDS has one.

        It is made of the addresses that the host had when the process started, so a host may have several.
        """
        return self.gid[2:4]


@cache
def this_host() -> str:
    """Return what all processes have in common that share one kernel and its addresses; empty if it is not known.

    Nobody can tell from it what it was made of.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()
        return sha256(f"{boot}{Path('/proc/self/ns/net').stat().st_ino}".encode()).hexdigest()[:16]
    except OSError:
        return ""


def writers_of(node: Node, topic: str, *, is_of_dds: bool = False) -> tuple[Endpoint, ...]:
    """Read the writers of a topic now, by its full name, or that of DDS; any node sees the whole graph.

    Raises RuntimeError if the middleware has no answer, and ValueError if a name is no text.
    """
    return _endpoints(rclpy_implementation.rclpy_get_publishers_info_by_topic, node, topic, is_of_dds=is_of_dds)


def readers_of(node: Node, topic: str, *, is_of_dds: bool = False) -> tuple[Endpoint, ...]:
    """Read the readers of a topic now, as `writers_of` does."""
    return _endpoints(rclpy_implementation.rclpy_get_subscriptions_info_by_topic, node, topic, is_of_dds=is_of_dds)


def _endpoints(
    read: Callable[[Any, str, bool], list[Mapping[str, Any]]], node: Node, topic: str, *, is_of_dds: bool
) -> tuple[Endpoint, ...]:
    # Not by the node's methods, which make more objects of each endpoint and take half as long again.
    with node.handle:
        return tuple(map(_endpoint, read(node.handle, topic, is_of_dds)))


def _endpoint(info: Mapping[str, Any]) -> Endpoint:
    name, qos, type_hash = info["node_name"], info["qos_profile"], info["topic_type_hash"]
    has_hash = type_hash["version"] > 0 and len(type_hash["value"]) == _HASH_BYTES
    return Endpoint(
        gid=bytes(info["endpoint_gid"]),
        node="" if name in _UNNAMED else f"{info['node_namespace'].rstrip('/')}/{name}",
        is_named=name != _NOT_NAMED_YET,
        type_name=info["topic_type"],
        type_hash=f"RIHS{type_hash['version']:02}_{type_hash['value'].hex()}" if has_hash else "",
        is_reliable=qos["reliability"] == QoSReliabilityPolicy.RELIABLE,
        is_latched=qos["durability"] == QoSDurabilityPolicy.TRANSIENT_LOCAL,
        deadline_ns=period_ns(qos["deadline"]),
        lifespan_ns=period_ns(qos["lifespan"]),
        lease_ns=period_ns(qos["liveliness_lease_duration"]),
        is_manual=qos["liveliness"] == QoSLivelinessPolicy.MANUAL_BY_TOPIC,
    )


def period_ns(duration: Any) -> int:
    """Return a period of a QoS profile, 0 = infinite, for which rclpy has 2^63-1 or 0 (ns)."""
    nanoseconds = int(duration.nanoseconds)
    return 0 if nanoseconds >= INFINITE_NS - 1 else nanoseconds  # one less is BEST_AVAILABLE


def policies_of(*, is_reliable: bool, is_latched: bool) -> dict[str, Any]:
    """Return reliability and durability as arguments of a QoS profile."""
    return {
        "reliability": QoSReliabilityPolicy.RELIABLE if is_reliable else QoSReliabilityPolicy.BEST_EFFORT,
        "durability": QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
    }


def type_name_of(msg_type: Any) -> str:
    """Return the ROS name of a message class, ``sensor_msgs/msg/LaserScan``."""
    package = msg_type.__module__.split(".")[0]
    return f"{package}/msg/{msg_type.__name__}"


class Requests:
    """QoS that the readers of a topic request, read at each question."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self.topic = topic

    def are_reliable(self) -> bool:
        """Return whether all readers are reliable."""
        return all(reader.is_reliable for reader in self._all())

    def names(self) -> list[str]:
        """Name the nodes that read the topic."""
        return sorted(map(_name, self._all()))

    def lost(self, offered_ns: int, offer_ns: int) -> list[str]:
        """Name the readers that hear a writer which offers the first deadline, and would not hear the second (ns)."""
        return sorted(
            f"{_name(reader)} requests {reader.deadline_ns} ns"
            for reader in self._all()
            if is_kept(offered_ns, reader.deadline_ns) and not is_kept(offer_ns, reader.deadline_ns)
        )

    def _all(self) -> tuple[Endpoint, ...]:
        try:
            return readers_of(self._node, self.topic)
        except ValueError:
            return ()  # who announces a name that is no text stops no swap


def _name(reader: Endpoint) -> str:
    return reader.node or "a node without a name"


class GraphView:
    """The graph, of which each part is read when somebody asks for it, and again after the graph has changed.

    The middleware tells that something has changed, but not what. So a look that finds a change forgets everything, and
    at rest a look costs 25 µs however large the graph is. To find the endpoints of one topic, the middleware goes
    through those of all topics: those of 1,000 topics take 0.1 s. After a change the next one is noticed only when ten
    times as long has passed as was spent on reading.

    There is one view for each context, because the middleware tells each change once. All of it may be used by any
    thread.

    Parameters
    ----------
    node : the first node that asks; it must live as long as the others

    Attributes
    ----------
    own : a writer of the node; its GUID names this process and this host
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.RLock()
        self._waits = rclpy_implementation.WaitSet(0, 1, 0, 0, 0, 0, node.context.handle)
        self._known: dict[tuple[str, str], Any] = {}
        self._types: Mapping[str, Sequence[str]] = {}
        self._services: Mapping[str, Sequence[str]] = {}
        self._changes = 0
        self._noticed_s = time.monotonic()
        self._spent_s = 0.0  # on reading since then
        self.own = Endpoint(gid=rcl().gid_of(next(iter(node.publishers)).handle), node=node.get_fully_qualified_name())

    @classmethod
    def of(cls, node: Node) -> GraphView:
        """Return the view of a node's context, made on first use."""
        return attached(node.context, cls, lambda: cls(node))

    def look(self) -> int:
        """Forget what was read if the graph has changed since; return how often it has."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._noticed_s >= self.rest_s and self._has_changed():
                self._known.clear()
                self._changes += 1
                self._noticed_s, self._spent_s = now_s, 0.0
            return self._changes

    @property
    def rest_s(self) -> float:
        """Time from the last change that was noticed until the next can be (s)."""
        return min(_MOST_REST_S, _RESTS * self._spent_s)

    @property
    def types(self) -> Mapping[str, Sequence[str]]:
        """The types of every topic; those before the change where the graph has a name that is no text."""
        self._types = self._once("types", "", lambda: dict(self._node.get_topic_names_and_types()), self._types)
        return self._types

    @property
    def services(self) -> Mapping[str, Sequence[str]]:
        """The types of every service, likewise."""
        read = self._node.get_service_names_and_types
        self._services = self._once("services", "", lambda: dict(read()), self._services)
        return self._services

    @property
    def participants(self) -> frozenset[bytes]:
        """First bytes of the GUIDs of every process with a node."""
        return frozenset(writer.participant for writer in self.writers(ON_EVERY_NODE))

    @property
    def ours(self) -> frozenset[bytes]:
        """Those of this process, and of all others with a node of this name.

        A killed process stays in the graph until DDS gives it up, and so do its ghosts. They belong to nobody here.
        """
        return self._once("ours", "", self._namesakes, frozenset({self.own.participant}))

    def writers(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the writers of a topic; none where the graph has a name that is no text."""
        return self._once("writers", topic, lambda: writers_of(self._node, topic), ())

    def writers_now(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the writers of a topic as they are at this moment, however long the graph may rest."""
        with self._lock:
            self._known.pop(("writers", topic), None)
            return self.writers(topic)

    def readers(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the readers of a topic, likewise."""
        return self._once("readers", topic, lambda: readers_of(self._node, topic), ())

    def servers(self, service: str) -> tuple[Endpoint, ...]:
        """Return the servers of a service, as the readers of the DDS topic of its requests."""
        topic = f"rq{service}Request"
        return self._once("servers", service, lambda: readers_of(self._node, topic, is_of_dds=True), ())

    def responders(self, service: str) -> tuple[Endpoint, ...]:
        """Return the same servers, as the writers of their responses."""
        topic = f"rr{service}Reply"
        return self._once("responders", service, lambda: writers_of(self._node, topic, is_of_dds=True), ())

    def _namesakes(self) -> frozenset[bytes]:
        found = (writer.participant for writer in self.writers(ON_EVERY_NODE) if writer.node == self.own.node)
        return frozenset({self.own.participant, *found})

    def _once(self, kind: str, name: str, read: Callable[[], T], default: T) -> T:
        """Return what was read since the last change, or read it now; the default where that fails."""
        with self._lock:
            if (kind, name) not in self._known:
                begun_s = time.monotonic()
                try:
                    self._known[kind, name] = read()
                except InvalidHandle:
                    raise
                except (RuntimeError, ValueError) as fault:
                    log.debug("%s of %s left out: %s", kind, name, fault)
                    self._known[kind, name] = default
                self._spent_s += time.monotonic() - begun_s
            found: T = self._known[kind, name]
            return found

    def _has_changed(self) -> bool:
        with self._node.handle, self._waits:
            self._waits.clear_entities()
            rcl().add_graph_guard(self._node.handle.pointer, self._waits.pointer)
            self._waits.wait(0)
            return bool(self._waits.get_ready_entities("guard_condition"))
