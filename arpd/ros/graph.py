"""Writers and readers of a topic, as the ROS graph shows them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSDurabilityPolicy, QoSLivelinessPolicy, QoSReliabilityPolicy

from arpd.model.plan import is_kept
from arpd.ros.names import INFINITE_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

# rmw_dds_common's names for the node of an endpoint whose participant has not named its nodes, yet or ever.
_NOT_NAMED_YET = "_NODE_NAME_UNKNOWN_"
_UNNAMED = frozenset({_NOT_NAMED_YET, "_CREATED_BY_BARE_DDS_APP_"})
_HASH_BYTES = 32


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
