"""Topics of the local domain that may cross the link, and their writers, read from the ROS graph."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSLivelinessPolicy, QoSReliabilityPolicy
from std_msgs.msg import Empty

from arpd.adapters.ros.events import no_publisher_events
from arpd.adapters.ros.graph import NOT_NAMED_YET, known_node_of, node_name_of, participant_of, period_ns_of
from arpd.adapters.ros.names import is_full_name
from arpd.apply.relay.offers import WriterOffer

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from rclpy.node import Node

_EVERY_LOOK = 10  # every tenth look at a topic reads its writers, even when their number is unchanged
_MOST_UNNAMED = 4  # looks; a writer made without ROS never has a node
_SOON_S = 0.02
_OWN_S = 2.0
_MOST_WRITERS = 2**16  # of one topic: their numbers have 16 bits
_REMEMBERED_S = 30.0  # a writer that left; its number is free again then


class Surveyed:
    """One topic as it was read last: types and writers of other processes than this one.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.
    """

    def __init__(self) -> None:
        self.types: tuple[str, ...] = ()
        self.writers: Mapping[str, WriterOffer] = {}  # by GUID
        self.known: Mapping[str, WriterOffer] = {}  # with those that left lately, whose samples may still come
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self.counted = -1
        self.read_s = -math.inf
        self._seen_s: dict[str, float] = {}
        self._unnamed: Counter[str] = Counter()  # looks at which a writer's node had no name

    def read(self, infos: list[Any], now_s: float, *, is_look: bool) -> bool:
        """Take the writers of the topic; return whether each has a node, or will never have one.

        Parameters
        ----------
        now_s : monotonic clock (s)
        is_look : whether this is one of the regular looks, after some of which a nameless node stays nameless
        """
        gids = {bytes(info.endpoint_gid).hex(): info for info in infos}
        self._unnamed = Counter({gid: count for gid, count in self._unnamed.items() if gid in gids})
        unnamed = [gid for gid, info in gids.items() if info.node_name == NOT_NAMED_YET]
        if is_look:
            self._unnamed.update(unnamed)
        waiting = {gid for gid in unnamed if self._unnamed[gid] < _MOST_UNNAMED}
        named = {gid: info for gid, info in gids.items() if gid not in waiting}
        self.types = tuple(sorted({info.topic_type for info in named.values()}))
        if self.type_name not in self.types:  # a stray writer of another type must not stop what already flows
            self.type_name = self.types[0] if len(self.types) == 1 else ""
        offered = {gid: info for gid, info in named.items() if info.topic_type == self.type_name}
        hashes = {type_hash_of(info) for info in offered.values()} - {""}
        self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        self._seen_s.update(dict.fromkeys(offered, now_s))
        self._seen_s = {gid: at_s for gid, at_s in self._seen_s.items() if now_s - at_s < _REMEMBERED_S}
        known = {gid: writer for gid, writer in self.known.items() if gid in self._seen_s}
        taken = {writer.number for writer in known.values()}
        free = (number for number in range(_MOST_WRITERS) if number not in taken)
        for gid, info in offered.items():
            number = known[gid].number if gid in known else next(free, None)
            if number is not None:
                known[gid] = _offer(info, gid, number)
        self.known = known
        self.writers = {gid: known[gid] for gid in offered if gid in known}
        return not waiting


class Survey:
    """Looks at the graph again and again; most looks only count the writers of each topic.

    Parameters
    ----------
    node : the end's node in the local domain
    own : first bytes of the GUIDs of this process there
    is_of_interest : returns whether to look at a topic, by its local name
    """

    def __init__(self, node: Node, *, own: bytes, is_of_interest: Callable[[str], bool]) -> None:
        self._node = node
        self._own = own
        self._ours = frozenset({own})
        self._is_of_interest = is_of_interest
        self._lock = threading.Lock()
        self._looks = 0
        self.participants: frozenset[str] = frozenset()  # first bytes of the GUIDs of every process with a node
        self.topics: Mapping[str, Surveyed] = {}
        self.types: Mapping[str, Sequence[str]] = {}  # of every topic, those of its readers and of this process too

    def look(self) -> None:
        """Read what has changed."""
        self._looks += 1
        infos = self._node.get_publishers_info_by_topic("/parameter_events")
        self.participants = frozenset(participant_of(info).hex() for info in infos)
        ours = namesakes(self._node, infos) | {self._own}
        is_changed, self._ours = ours != self._ours, ours
        self.types = dict(self._node.get_topic_names_and_types())
        found = {topic for topic in self.types if is_full_name(topic) and self._is_of_interest(topic)}
        topics = {topic: self.topics.get(topic) or Surveyed() for topic in sorted(found)}
        self.topics = topics
        for number, (topic, surveyed) in enumerate(topics.items()):
            with self._node.handle:  # Node.count_publishers would check the name again
                writers = self._node.handle.get_count_publishers(topic)
            if is_changed or writers != surveyed.counted or (self._looks + number) % _EVERY_LOOK == 0:
                self.read(topic, is_look=True)

    def read(self, topic: str, *, is_look: bool = False) -> Surveyed | None:
        """Read the writers of one topic now; for any thread."""
        surveyed = self.topics.get(topic)
        if surveyed is not None:
            with self._lock:
                infos = self._node.get_publishers_info_by_topic(topic)
                others = [info for info in infos if participant_of(info) not in self._ours]
                surveyed.read_s = time.monotonic()
                surveyed.counted = len(infos) if surveyed.read(others, surveyed.read_s, is_look=is_look) else -1
        return surveyed

    def read_soon(self, topic: str) -> Surveyed | None:
        """Read them unless that was done just now; for a caller that asks with every sample."""
        surveyed = self.topics.get(topic)
        if surveyed is not None and time.monotonic() - surveyed.read_s < _SOON_S:
            return surveyed
        return self.read(topic)

    def gids(self, topic: str) -> Collection[str]:
        """Return the GUIDs of the topic's writers, without those of this process."""
        surveyed = self.topics.get(topic)
        return surveyed.writers.keys() if surveyed is not None else ()

    def conflicts(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield the topics with more than one type, and the types."""
        return ((topic, each.types) for topic, each in self.topics.items() if len(each.types) > 1)


def own_participant(node: Node) -> bytes:
    """Return the first bytes of the GUIDs of a node's process in its domain, by a topic that no other one writes."""
    return participant_of(_own_writer(node, Empty))


def own_type_hash(node: Node, kind: Any) -> str:
    """Return the hash of a message class of this process, as its writers tell it; empty if they tell none."""
    return type_hash_of(_own_writer(node, kind))


def type_hash_of(info: Any) -> str:
    """Return the hash of an endpoint's type (REP 2016); empty where its middleware tells none."""
    text = str(info.topic_type_hash)
    return text if text.startswith("RIHS") else ""


def _own_writer(node: Node, kind: Any) -> Any:
    """Return the graph's description of a writer that lives no longer than this call."""
    publisher = node.create_publisher(kind, f"~/arpd_{secrets.token_hex(8)}", 1, event_callbacks=no_publisher_events())
    try:
        until_s = time.monotonic() + _OWN_S
        while time.monotonic() < until_s:
            for info in node.get_publishers_info_by_topic(publisher.topic_name):
                return info
            time.sleep(0.01)
    finally:
        node.destroy_publisher(publisher)
    raise RuntimeError(f"{node.get_fully_qualified_name()} is not in its own graph")


def namesakes(node: Node, infos: Iterable[Any] | None = None) -> frozenset[bytes]:
    """Return the first bytes of the GUIDs of all processes with a node of this name.

    A killed end stays in the graph until DDS gives it up, and so do its ghosts. They belong to nobody on this side.

    Parameters
    ----------
    infos : writers of /parameter_events, which every node of rclpy writes; read here when None
    """
    own = node.get_fully_qualified_name()
    if infos is None:
        infos = node.get_publishers_info_by_topic("/parameter_events")
    return frozenset(participant_of(info) for info in infos if node_name_of(info) == own)


def _offer(info: Any, gid: str, number: int) -> WriterOffer:
    qos = info.qos_profile
    return WriterOffer(
        number=number,
        node=known_node_of(info),
        gid=gid,
        is_reliable=qos.reliability == QoSReliabilityPolicy.RELIABLE,
        is_latched=qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL,
        deadline_ns=period_ns_of(qos.deadline),
        lifespan_ns=period_ns_of(qos.lifespan),
        lease_ns=period_ns_of(qos.liveliness_lease_duration),
        is_manual=qos.liveliness == QoSLivelinessPolicy.MANUAL_BY_TOPIC,
    )
