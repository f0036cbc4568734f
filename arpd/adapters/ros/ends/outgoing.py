"""Topics that the other side reads: their samples from this side's writers, onto the link."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd.adapters.ros.ends.raw_reader import RawReader, ReadingThread, Sample
from arpd.adapters.ros.ends.types import UnknownTypeError, message_class
from arpd.adapters.ros.publisher import AdaptivePublisher
from arpd.apply.relay.envelope import Record, pack, source_of
from arpd.apply.relay.sets import Sets
from arpd.model.settings import DEFAULT_RELAY_DEPTH, Overflow

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.adapters.ros.ends.survey import Survey
    from arpd.apply.relay.offers import TopicOffer
    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)
_RECEIVE_DEPTH = (
    1000  # within the host, so this only bridges the end's own scheduling, and holds every writer's history
)
_LATCHED_DEPTH = 1000
_MOST_HELD = 1000
_LINGER_S = 3.0

Class = tuple[bool, bool]  # whether writers are reliable, and latched


class Names:
    """Names under which topics cross the link: a group's for its topics, in their order, and their own for others."""

    def __init__(self, settings: RelaySettings) -> None:
        self._of = {
            topic: (group.name, member) for group in settings.groups for member, topic in enumerate(group.topics)
        }
        self._groups = {group.name for group in settings.groups}

    def of(self, topic: str) -> tuple[str, int]:
        """Return the name on the link, and the place in the group."""
        return self._of.get(topic, (topic, 0))

    def is_group(self, link_name: str) -> bool:
        """Return whether a group crosses under this name."""
        return link_name in self._groups


@dataclass(slots=True)
class _Carried:
    """One topic, or one group of topics, on the link."""

    publisher: AdaptivePublisher
    sets: Sets | None
    wanted_s: float  # when it was wanted last
    wanted: set[str] = field(default_factory=set)
    readers: dict[tuple[str, Class], RawReader] = field(default_factory=dict)
    held: deque[tuple[str, Class, Sample]] = field(default_factory=lambda: deque(maxlen=_MOST_HELD))
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def is_latched(self) -> bool:
        """True if it has a reader of latched writers."""
        return any(is_latched for _, (_, is_latched) in self.readers)


class Outgoing:
    """Reads the wanted topics and offers their samples to AdaptivePublishers on the link.

    Each class of writers (reliable or not, latched or not) has a reader of its own, which takes the samples of that
    class only. So a reliable writer stays reliable when a best-effort one joins, and no reader is ever replaced. A
    topic is read once its writer on the link has a reader there: a history would be lost otherwise.

    Parameters
    ----------
    node, link_node : the end's nodes in the local domain and in that of the link
    survey : topics of the local domain and their writers
    thread : takes the samples
    local_name : returns the local name of a topic
    settings : groups, overflow and depths
    session : of this process, 32 bit
    """

    def __init__(
        self,
        *,
        node: Node,
        link_node: Node,
        survey: Survey,
        thread: ReadingThread,
        local_name: Callable[[str], str],
        settings: RelaySettings,
        session: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._link_node = link_node
        self._survey = survey
        self._thread = thread
        self._local_name = local_name
        self._settings = settings
        self._session = session
        self._clock = clock
        self._names = Names(settings)
        self._carried: dict[str, _Carried] = {}  # by the name on the link
        self._readers_gids = ""
        self.refused: dict[str, str] = {}

    @property
    def carried(self) -> frozenset[str]:
        """Topics that are read here and sent over the link."""
        return frozenset(topic for carried in self._carried.values() for topic, _ in carried.readers)

    @property
    def incomplete(self) -> int:
        """Count the samples of groups whose set was never complete."""
        return sum(carried.sets.dropped for carried in self._carried.values() if carried.sets is not None)

    def follow(self, wants: frozenset[str], offers: Mapping[str, TopicOffer]) -> None:
        """Carry the wanted topics, and no other."""
        wanted: dict[str, set[str]] = {}
        for topic in wants & offers.keys():
            wanted.setdefault(self._names.of(topic)[0], set()).add(topic)
        self._drop_unwanted(wanted.keys())
        self.refused = {topic: reason for topic, reason in self.refused.items() if topic in wants}
        for link_name, topics in wanted.items():
            carried = self._carried.get(link_name)
            if carried is None:
                offered = [offers[topic] for topic in topics]
                carried = self._carried[link_name] = self._carry(link_name, offered)
            carried.wanted = topics
            if carried.sets is not None:
                with carried.lock:
                    carried.sets.members = {self._names.of(topic)[1] for topic in topics}
            for topic, kind in [key for key in carried.readers if key[0] not in topics]:
                carried.readers.pop((topic, kind)).destroy()
        self.step(offers)

    def step(self, offers: Mapping[str, TopicOffer]) -> None:
        """Open the readers of topics whose writer on the link has found its reader there."""
        for carried in self._carried.values():
            if not carried.readers and not self._is_heard(carried.publisher):
                continue
            for topic in carried.wanted & offers.keys():
                for kind in {(writer.is_reliable, writer.is_latched) for writer in offers[topic].writers}:
                    if (topic, kind) not in carried.readers and topic not in self.refused:
                        self._read(carried, topic, kind, offers[topic].type_name)
            with carried.lock:
                self._deliver_held(carried)

    def _drop_unwanted(self, wanted: Collection[str]) -> None:
        """Drop what has not been wanted for a while: an end that has just started wants nothing at first."""
        now_s = self._clock()
        for link_name, carried in list(self._carried.items()):
            if link_name in wanted:
                carried.wanted_s = now_s
            elif now_s - carried.wanted_s > _LINGER_S:
                self._drop(link_name)

    def forget(self) -> None:
        """Carry nothing: there is no other end."""
        for link_name in list(self._carried):
            self._drop(link_name)

    def meet(self, link_gids: str) -> None:
        """Carry latched topics anew: the other end is another process now, and lacks their histories.

        They are read once a reader of that process has matched: for some seconds those of the dead one still do.

        The other topics stay as they are, because the new process may hear them already: it asks for what it reads a
        second after its start, and new writers would cost it the samples of their match.

        Parameters
        ----------
        link_gids : first bytes of the GUIDs of its endpoints on the link, in hexadecimal digits; empty = not known
        """
        self._readers_gids = link_gids
        for link_name in [name for name, carried in self._carried.items() if carried.is_latched]:
            self._drop(link_name)

    def _is_heard(self, publisher: AdaptivePublisher) -> bool:
        """Return whether the other end's process reads it, and not only the one before."""
        if not publisher.get_subscription_count():
            return False
        found = self._link_node.get_subscriptions_info_by_topic(publisher.topic_name)
        return any(bytes(info.endpoint_gid).hex().startswith(self._readers_gids) for info in found)

    def _carry(self, link_name: str, offers: list[TopicOffer]) -> _Carried:
        settings = self._settings
        is_latched = any(writer.is_latched for offer in offers for writer in offer.writers)
        is_group = self._names.is_group(link_name)
        depth = settings.depths.get(link_name, DEFAULT_RELAY_DEPTH)
        publisher = AdaptivePublisher(
            self._link_node,
            UInt8MultiArray,
            link_name,
            # TRANSIENT_LOCAL on the link keeps the plan from shortening the depth, so that no history overflows it.
            QoSProfile(
                depth=max(depth, _LATCHED_DEPTH) if is_latched else depth,
                durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
            ),
            overflow=settings.overflow.get(link_name, Overflow.QUEUE if is_latched else Overflow.LATEST),
            source_of=None if is_group else source_of,
        )
        return _Carried(publisher=publisher, sets=Sets(()) if is_group else None, wanted_s=self._clock())

    def _read(self, carried: _Carried, topic: str, kind: Class, type_name: str) -> None:
        is_reliable, is_latched = kind

        def deliver(sample: Sample) -> None:
            with carried.lock:
                if carried.held:  # earlier samples, perhaps of the same writer
                    carried.held.append((topic, kind, sample))
                    self._deliver_held(carried)
                else:
                    self._deliver(carried, topic, kind, sample)

        try:
            carried.readers[topic, kind] = RawReader(
                self._node,
                message_class(type_name),
                self._local_name(topic),
                QoSProfile(
                    depth=_RECEIVE_DEPTH,
                    reliability=QoSReliabilityPolicy.RELIABLE if is_reliable else QoSReliabilityPolicy.BEST_EFFORT,
                    durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
                ),
                deliver=deliver,
                thread=self._thread,
            )
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            self.refused[topic] = str(fault)

    def _deliver(self, carried: _Carried, topic: str, kind: Class, sample: Sample) -> None:
        """Send a sample if its writer is of the reader's class; hold it while the graph does not name the writer."""
        gid = sample.writer.hex()
        surveyed = self._survey.topics.get(self._local_name(topic))
        writer = surveyed.writers.get(gid) if surveyed is not None else None
        if writer is None:
            surveyed = self._survey.read_soon(self._local_name(topic))
            writer = surveyed.writers.get(gid) if surveyed is not None else None
        if writer is None:
            carried.held.append((topic, kind, sample))
        elif (writer.is_reliable, writer.is_latched) == kind:
            record = Record(self._names.of(topic)[1], writer.number, sample.sequence, sample.data)
            records: list[Record] | None = [record]
            if carried.sets is not None:
                records = carried.sets.add(record)
            if records is not None:
                carried.publisher.offer(pack(self._session, records))

    def _deliver_held(self, carried: _Carried) -> None:
        for _ in range(len(carried.held)):
            self._deliver(carried, *carried.held.popleft())

    def _drop(self, link_name: str) -> None:
        carried = self._carried.pop(link_name)
        for reader in carried.readers.values():
            reader.destroy()
        carried.publisher.destroy()
