"""Topics of the ROS graph, sorted by what their nodes on this host and beyond do with them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.link_topics import LinkTopic
from arpd.ros.graph import ON_EVERY_NODE, GraphView
from arpd.ros.names import is_full_name
from arpd.ros.runtime import PROFILE_VARIABLE, UDP_PROFILE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from arpd.ros.graph import Endpoint
    from arpd.ros.rmw import Rmw

_RELAYS = "arpd_relay"  # names of its nodes begin so, unless the user gives another one (--node-name)
_OWN_NODES = frozenset({"/arpd", "/arpd_peer"})  # what the daemon and the peer publish is no traffic of the robot


@dataclass(frozen=True, slots=True)
class FoundTopic:
    """One topic with all its endpoints, without those of this process."""

    types: tuple[str, ...]
    writers: tuple[Endpoint, ...]
    readers: tuple[Endpoint, ...]


def is_confined(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether ROS in this process sees the nodes of this host only."""
    wanted = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    is_profiled = environment.get(PROFILE_VARIABLE) == str(UDP_PROFILE)  # which stands for that range
    return is_profiled or wanted == "LOCALHOST" or environment.get("ROS_LOCALHOST_ONLY") == "1"


def cannot_tell_hosts(rmw: Rmw, environment: Mapping[str, str] = os.environ) -> str:
    """Return why no endpoint shows its host; empty if each does, or if all are on this one."""
    if rmw.tells_hosts or is_confined(environment):
        return ""
    return (
        "the middleware does not show on which host a node is (no Fast DDS, or SROS 2); with "
        "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST `arpd topics` sees and measures the nodes of this host"
    )


class LinkGraph:
    """The topics of a graph, and the sides of their endpoints.

    Where the middleware tells no hosts, no endpoint is on this one, unless this process sees no other.
    """

    def __init__(self, view: GraphView, rmw: Rmw) -> None:
        self.view, self._rmw = view, rmw
        self._is_confined = is_confined()
        self._relays: frozenset[bytes] = frozenset()  # processes on this host; their ghosts stand for nodes beyond
        self._topics: dict[str, FoundTopic] = {}
        self._changes = -1  # of the graph, when it was read last

    def __getitem__(self, name: str) -> FoundTopic:
        return self._topics[name]

    def look(self) -> bool:
        """Read the graph; return whether its topics have changed. A topic that left stays as it was."""
        if self._changes == (changes := self.view.look()):
            return False
        before, self._changes, view = self._topics, changes, self.view
        found = {
            name: FoundTopic(tuple(sorted(types)), self._others(view.writers(name)), self._others(view.readers(name)))
            for name, types in view.types.items()
            if is_full_name(name)
        }
        self._topics = before | {name: topic for name, topic in found.items() if topic.writers or topic.readers}
        relays = (each for each in view.writers(ON_EVERY_NODE) if each.node.rpartition("/")[2].startswith(_RELAYS))
        self._relays = frozenset(each.participant for each in relays if self._is_here(each))
        return self._topics != before

    def topics(self, *, prefix: str) -> list[LinkTopic]:
        """Return every topic, sorted by name, with the sides of its endpoints; the prefix is that of `TopicSurvey`."""
        found = self._topics
        outputs = {name: prefix + name for name in found if prefix and self._is_output(found.get(prefix + name))}
        topics = []
        for name in sorted(found.keys() - set(outputs.values())):
            topic = found[name]
            far_readers = [each for each in topic.readers if not self._is_ours(each)]
            if name in outputs:
                all_readers = (*topic.readers, *found[outputs[name]].readers)
                far_readers = [each for each in all_readers if not self._is_here(each)]
            topics.append(
                LinkTopic(
                    name=name,
                    types=topic.types,
                    writers=_names(filter(self._is_ours, topic.writers)),
                    readers=_names(filter(self._is_ours, topic.readers)),
                    far_writers=_names(each for each in topic.writers if not self._is_ours(each)),
                    far_readers=_names(far_readers),
                    is_latched=any(endpoint.is_latched for endpoint in topic.writers or topic.readers),
                    relayed_as=outputs.get(name, ""),
                )
            )
        return topics

    def obstacle(self, name: str) -> str:
        """Return why a reader of this process would disturb, or would get nothing; empty if it may measure."""
        topic = self._topics[name]
        if not topic.writers:
            return "nobody publishes it now"
        if len(topic.types) > 1:
            return f"it has {len(topic.types)} types: {', '.join(topic.types)}"
        if not all(map(self._is_here, topic.writers)):
            return "it comes from beyond this host, and measuring would bring it over the link once more"
        if not (all(map(self._is_ours, topic.writers)) or any(map(self._is_ours, topic.readers))):
            return "it would cross the link only to be measured: nobody here reads it"
        return ""

    def _others(self, endpoints: Iterable[Endpoint]) -> tuple[Endpoint, ...]:
        own = self.view.own.participant
        return tuple(each for each in endpoints if each.participant != own and each.node not in _OWN_NODES)

    def _is_here(self, endpoint: Endpoint) -> bool:
        return self._is_confined or (self._rmw.tells_hosts and endpoint.host == self.view.own.host)

    def _is_ours(self, endpoint: Endpoint) -> bool:
        """Return whether it belongs to a node of this host; a relay's ghosts do not."""
        return self._is_here(endpoint) and endpoint.participant not in self._relays

    def _is_output(self, topic: FoundTopic | None) -> bool:
        """Return whether a relay on this host alone writes it."""
        writers = topic.writers if topic else ()
        return bool(writers) and all(each.participant in self._relays for each in writers)


def _names(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    return tuple(sorted({endpoint.node for endpoint in endpoints}))
