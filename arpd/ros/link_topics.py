"""Topics of the ROS graph, sorted by what their nodes on this host and beyond do with them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.link_topics import LinkTopic
from arpd.ros.graph_view import ON_EVERY_NODE
from arpd.ros.names import is_full_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from arpd.ros.graph import Endpoint
    from arpd.ros.graph_view import GraphView
    from arpd.ros.rmw import Rmw

_RELAYS = "arpd_relay"  # names of its nodes begin so, unless the user gives another one (--node-name)
_OWN_NODES = frozenset({"/arpd", "/arpd_peer"})  # what the daemon and the peer publish is no traffic of the robot


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
    is_here : returns whether an endpoint is on this host; it may be arpd's relay
    relays : processes of arpd's relay on this host; its ghosts stand for nodes beyond
    """

    is_here: Callable[[Endpoint], bool]
    relays: frozenset[bytes]

    def is_ours(self, endpoint: Endpoint) -> bool:
        """Return whether it belongs to a node of this host."""
        return self.is_here(endpoint) and not self.is_relayed(endpoint)

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


def find_topics(view: GraphView) -> list[FoundTopic]:
    """Return every topic of the graph that another process uses, sorted by name."""

    def others(endpoints: Iterable[Endpoint]) -> tuple[Endpoint, ...]:
        own = view.own.participant
        return tuple(each for each in endpoints if each.participant != own and each.node not in _OWN_NODES)

    found = (
        FoundTopic(
            name=topic,
            types=tuple(sorted(types)),
            writers=others(view.writers(topic)),
            readers=others(view.readers(topic)),
        )
        for topic, types in sorted(view.types.items())
        if is_full_name(topic)
    )
    return [topic for topic in found if topic.writers or topic.readers]


def find_sides(view: GraphView, rmw: Rmw) -> Sides:
    """Return where endpoints are; without knowledge none is on this host."""
    all_are_here = is_confined()

    def is_here(endpoint: Endpoint) -> bool:
        return all_are_here or (rmw.tells_hosts and endpoint.host == view.own.host)

    writers = filter(is_here, view.writers(ON_EVERY_NODE))
    relays = {writer.participant for writer in writers if writer.node.rpartition("/")[2].startswith(_RELAYS)}
    return Sides(is_here=is_here, relays=frozenset(relays))


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
            beyond = _names(each for each in (*topic.readers, *output.readers) if not sides.is_here(each))
            sorted_topic = replace(sorted_topic, relayed_as=output.name, far_readers=beyond)
        topics.append(sorted_topic)
    return topics


def obstacle(topic: FoundTopic, sides: Sides) -> str:
    """Return why a reader of this process would disturb, or would get nothing; empty if it may measure."""
    if not topic.writers:
        return "nobody publishes it now"
    if len(topic.types) > 1:
        return f"it has {len(topic.types)} types: {', '.join(topic.types)}"
    if any(not sides.is_here(writer) for writer in topic.writers):
        return "it comes from beyond this host, and measuring would bring it over the link once more"
    comes_over_the_link = any(map(sides.is_relayed, topic.writers))
    if comes_over_the_link and not any(map(sides.is_ours, topic.readers)):
        return "it would cross the link only to be measured: nobody here reads it"
    return ""


def _is_output(topic: FoundTopic, by_name: Mapping[str, FoundTopic], sides: Sides, prefix: str) -> bool:
    """Return whether a relay with one end on this host republishes the topic."""
    output = by_name.get(prefix + topic.name) if prefix else None
    return output is not None and bool(output.writers) and all(map(sides.is_relayed, output.writers))


def _names(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    return tuple(sorted({endpoint.node for endpoint in endpoints}))
