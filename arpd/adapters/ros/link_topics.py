"""Topics of the ROS graph, sorted by what their nodes on this host and beyond do with them."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import NameValidationException
from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy

from arpd.adapters.ros.graph import known_node_of, node_name_of, participant_of
from arpd.adapters.ros.names import is_full_name
from arpd.model.link_topics import LinkTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from rclpy.node import Node

    from arpd.adapters.ros.rmw import Rmw

log = logging.getLogger(__name__)
_RELAYS = "arpd_relay"  # names of its nodes begin so, unless the user gives another one (--node-name)
_OWN_NODES = frozenset({"/arpd", "/arpd_peer"})  # what the daemon and the peer publish is no traffic of the robot
_ON_EVERY_NODE = "/parameter_events"


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """One writer or reader.

    Parameters
    ----------
    participant : its process in the domain
    node : its node, empty = unknown
    is_reliable, is_latched : its reliability and durability
    """

    participant: bytes
    node: str
    is_reliable: bool
    is_latched: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundTopic:
    """One topic with all its endpoints, without those of this process."""

    name: str
    types: tuple[str, ...]
    writers: tuple[Endpoint, ...]
    readers: tuple[Endpoint, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Sides:
    """Where endpoints are.

    Parameters
    ----------
    is_here : returns whether a process is on this host, by the first bytes of its GUIDs; it may be arpd's relay
    relays : processes of arpd's relay on this host; its ghosts stand for nodes beyond
    """

    is_here: Callable[[bytes], bool]
    relays: frozenset[bytes]

    def is_ours(self, endpoint: Endpoint) -> bool:
        """Return whether it belongs to a node of this host."""
        return self.is_here(endpoint.participant) and not self.is_relayed(endpoint)

    def is_relayed(self, endpoint: Endpoint) -> bool:
        """Return whether it belongs to arpd's relay on this host."""
        return endpoint.participant in self.relays


def is_confined(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether ROS in this process sees the nodes of this host only."""
    wanted = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return wanted == "LOCALHOST" or environment.get("ROS_LOCALHOST_ONLY") == "1"


def cannot_tell_hosts(rmw: Rmw, environment: Mapping[str, str] = os.environ) -> str:
    """Return why no endpoint shows its host; empty if each does, or if all are on this one."""
    if rmw.tells_hosts or is_confined(environment):
        return ""
    return (
        "the middleware does not show on which host a node is (no Fast DDS, or SROS 2); with "
        "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST `arpd topics` sees and measures the nodes of this host"
    )


def find_topics(node: Node, *, own: bytes) -> list[FoundTopic]:
    """Return every topic of the graph that another process uses, sorted by name.

    Parameters
    ----------
    own : first bytes of the GUIDs of this process
    """
    found = []
    for topic, types in sorted(node.get_topic_names_and_types()):
        if not is_full_name(topic):
            continue
        try:
            written, read = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
        except (ValueError, NameValidationException) as fault:  # a foreign middleware may have what ROS has not
            log.debug("%s left out: %s", topic, fault)
            continue
        writers, readers = _endpoints(written, own), _endpoints(read, own)
        if writers or readers:
            found.append(FoundTopic(name=topic, types=tuple(sorted(types)), writers=writers, readers=readers))
    return found


def relays_of(node: Node, *, is_here: Callable[[bytes], bool]) -> frozenset[bytes]:
    """Return the processes of arpd's relay on this host."""
    infos = node.get_publishers_info_by_topic(_ON_EVERY_NODE)
    relays = {participant_of(info) for info in infos if info.node_name.startswith(_RELAYS)}
    return frozenset(filter(is_here, relays))


def sorted_topics(found: Sequence[FoundTopic], sides: Sides, *, prefix: str) -> list[LinkTopic]:
    """Return the topics by the sides of their endpoints: pure.

    Parameters
    ----------
    prefix : under which a relay with one end republishes topics; empty = there is none
    """
    by_name = {topic.name: topic for topic in found}
    outputs = {topic.name: prefix + topic.name for topic in found if _is_output(topic, by_name, sides, prefix)}
    topics = []
    for topic in found:
        if topic.name in outputs.values():
            continue
        output = by_name.get(outputs.get(topic.name, ""))
        sorted_topic = LinkTopic(
            name=topic.name,
            types=topic.types,
            writers=_names(filter(sides.is_ours, topic.writers)),
            readers=_names(filter(sides.is_ours, topic.readers)),
            far_writers=_names(each for each in topic.writers if not sides.is_ours(each)),
            far_readers=_names(each for each in topic.readers if not sides.is_ours(each)),
            is_latched=any(endpoint.is_latched for endpoint in topic.writers or topic.readers),
        )
        if output is not None:
            beyond = [reader for reader in topic.readers if not sides.is_here(reader.participant)]
            beyond += [reader for reader in output.readers if not sides.is_here(reader.participant)]
            sorted_topic = replace(sorted_topic, relayed_as=output.name, far_readers=_names(beyond))
        topics.append(sorted_topic)
    return topics


def obstacle(topic: FoundTopic, sides: Sides) -> str:
    """Return why a reader of this process would disturb, or would get nothing; empty if it may measure."""
    if not topic.writers:
        return "nobody publishes it now"
    types = {*topic.types}
    if len(types) > 1:
        return f"it has {len(types)} types: {', '.join(sorted(types))}"
    if any(not sides.is_here(writer.participant) for writer in topic.writers):
        return "it comes from beyond this host, and measuring would bring it over the link once more"
    comes_over_the_link = any(map(sides.is_relayed, topic.writers))
    if comes_over_the_link and not any(map(sides.is_ours, topic.readers)):
        return "it would cross the link only to be measured: nobody here reads it"
    return ""


def _is_output(topic: FoundTopic, by_name: Mapping[str, FoundTopic], sides: Sides, prefix: str) -> bool:
    """Return whether a relay with one end on this host republishes the topic."""
    output = by_name.get(prefix + topic.name) if prefix else None
    return output is not None and bool(output.writers) and all(map(sides.is_relayed, output.writers))


def _endpoints(infos: Iterable[Any], own: bytes) -> tuple[Endpoint, ...]:
    others = (info for info in infos if participant_of(info) != own and node_name_of(info) not in _OWN_NODES)
    return tuple(
        Endpoint(
            participant=participant_of(info),
            node=known_node_of(info),
            is_reliable=info.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE,
            is_latched=info.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL,
        )
        for info in others
    )


def _names(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    names: Collection[str] = {endpoint.node for endpoint in endpoints}
    return tuple(sorted(names))
