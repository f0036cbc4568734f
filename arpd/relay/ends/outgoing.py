"""Topics that the other side reads: their samples from this side's writers, onto the link."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.endpoint.lane import Lane
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.link_topic import LinkTopic
from arpd.relay.ends.topic_readers import TopicReaders
from arpd.relay.ends.types import UnknownTypeError, message_class
from arpd.relay.envelope import Record, key_of, pack
from arpd.relay.sets import Sets
from arpd.ros.graph import readers_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings
    from arpd.relay.ends.link_thread import LinkThread
    from arpd.relay.ends.survey import Survey
    from arpd.relay.offers import TopicOffer, WriterOffer
    from arpd.relay.selection import Side
    from arpd.ros.raw_reader import ReadingThread, Sample

_HISTORY = 1000  # most small samples of a latched writer; of its large ones, a map for example, the newest
_LINGER_S = 3.0


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

    publisher: LinkTopic
    sets: Sets | None
    is_latched: bool  # on the link
    wanted_s: float  # when it was wanted last
    wanted: set[str] = field(default_factory=set)
    types: dict[str, str] = field(default_factory=dict)  # of its topics
    readers: dict[str, TopicReaders] = field(default_factory=dict)  # of its topics
    lock: threading.Lock = field(default_factory=threading.Lock)  # guards the sets

    def close_readers(self, topics: Collection[str]) -> None:
        """Destroy the readers of these topics."""
        for topic in self.readers.keys() & topics:
            self.readers.pop(topic).destroy()


class Outgoing:
    """Reads the wanted topics and offers their samples to the paced queue of the link.

    A topic is read once its writer on the link has a reader there: a history would be lost otherwise.

    Parameters
    ----------
    node, link_node : the end's nodes in the local domain and in that of the link
    survey : topics of the local domain and their writers
    thread : takes the samples
    link : writes to the link
    side : names on this side
    settings : groups, overflow and depths
    """

    def __init__(
        self,
        *,
        node: Node,
        link_node: Node,
        survey: Survey,
        thread: ReadingThread,
        link: LinkThread,
        side: Side,
        settings: RelaySettings,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._link_node = link_node
        self._survey = survey
        self._thread = thread
        self._link = link
        self._side = side
        self._settings = settings
        self._clock = clock
        self.names = Names(settings)
        self._carried: dict[str, _Carried] = {}  # by the name on the link
        self._readers_gids = ""
        self._incomplete = 0  # of groups that are not carried any more
        self.refused: dict[str, str] = {}

    @property
    def carried(self) -> frozenset[str]:
        """Topics that are read here and sent over the link."""
        return frozenset(topic for carried in self._carried.values() for topic in carried.readers)

    @property
    def plans(self) -> dict[str, tuple[int, int]]:
        """DEPTH and DEADLINE that the daemon has planned (samples, ns), by the name on the link."""
        plans = {name: carried.publisher.plan for name, carried in self._carried.items()}
        return {name: plan.qos for name, plan in plans.items() if plan.weight > 0}

    @property
    def incomplete(self) -> int:
        """Count the samples of groups whose set was never complete."""
        return self._incomplete + sum(each.sets.dropped for each in self._carried.values() if each.sets is not None)

    def living(self, topic: str, writers: Iterable[WriterOffer]) -> tuple[WriterOffer, ...]:
        """Return the writers of a topic by their numbers, each with whether it is alive."""
        carried = self._carried.get(self.names.of(topic)[0])
        readers = None if carried is None else carried.readers.get(topic)
        return tuple(
            replace(writer, is_alive=readers is not None and readers.are_alive(writer)) if writer.is_manual else writer
            for writer in sorted(writers, key=lambda writer: writer.number)
        )

    def follow(self, wants: frozenset[str], offers: Mapping[str, TopicOffer]) -> None:
        """Carry the wanted topics, and no other."""
        wanted: dict[str, set[str]] = {}
        for topic in wants & offers.keys():
            wanted.setdefault(self.names.of(topic)[0], set()).add(topic)
        self._drop_unwanted(wanted.keys())
        self.refused = {topic: reason for topic, reason in self.refused.items() if topic in wants}
        for link_name, topics in wanted.items():
            is_latched = any(writer.is_latched for topic in topics for writer in offers[topic].writers)
            carried = self._carried.get(link_name)
            if carried is not None and is_latched and not carried.is_latched:
                self._drop(link_name)  # the history of a latched writer that joins needs a deep writer on the link
                carried = None
            if carried is None:
                carried = self._carried[link_name] = self._carry(link_name, is_latched=is_latched)
            carried.close_readers(carried.wanted - topics)
            carried.wanted = topics
        self.step(offers)

    def step(self, offers: Mapping[str, TopicOffer]) -> None:
        """Open the readers of topics whose writer on the link has found its reader there."""
        for carried in self._carried.values():
            if not carried.readers and not self._is_heard(carried.publisher):
                continue
            for topic in carried.wanted & offers.keys():
                self._read(carried, topic, offers[topic])
            if carried.sets is not None:
                with carried.lock:
                    carried.sets.members = {self.names.of(topic)[1] for topic in carried.wanted - self.refused.keys()}

    def _read(self, carried: _Carried, topic: str, offer: TopicOffer) -> None:
        if carried.types.get(topic) != offer.type_name:
            carried.close_readers((topic,))
            carried.types[topic] = offer.type_name
            self.refused.pop(topic, None)
        if topic in self.refused:
            return
        try:
            if topic not in carried.readers:
                carried.readers[topic] = self._readers(carried, topic, offer.type_name)
            carried.readers[topic].follow(offer.writers)
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            self.refused[topic] = str(fault)

    def _readers(self, carried: _Carried, topic: str, type_name: str) -> TopicReaders:
        message = message_class(type_name)
        if carried.sets is not None and not has_header(message):
            raise ValueError(f"{type_name} has no header stamp, by which its group is thinned")
        return TopicReaders(
            self._node,
            self._side.local_name(topic),
            message,
            survey=self._survey,
            thread=self._thread,
            deliver=partial(self._send, carried, self.names.of(topic)[1]),
            depth=self._settings.depths.get(topic),
            clock=self._clock,
        )

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
        """Begin again with latched topics: the other end is another process now, and lacks their histories.

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

    def _is_heard(self, publisher: LinkTopic) -> bool:
        """Return whether the other end's process reads it, and not only the one before."""
        if not publisher.get_subscription_count():
            return False
        readers = readers_of(self._link_node, publisher.topic_name)
        return any(reader.gid.hex().startswith(self._readers_gids) for reader in readers)

    def _carry(self, link_name: str, *, is_latched: bool) -> _Carried:
        depth = self._settings.depths.get(link_name)

        def lane(write: Callable[[bytes], None]) -> Lane:
            if link_name in self._settings.queued:
                most = depth or DEFAULT_RELAY_DEPTH
                return Lane(write, depth=most, large_depth=most, is_ordered=True, is_kept=True)
            if is_latched:
                return Lane(write, depth=depth or _HISTORY, large_depth=depth or 1, is_kept=True)
            # A set of a group leaves alone: it is seldom small.
            return Lane(write, key=None if self.names.is_group(link_name) else key_of(link_name))

        publisher = LinkTopic(
            self._link_node, link_name, thread=self._link, make_lane=lane, depth=depth or DEFAULT_RELAY_DEPTH
        )
        sets = Sets(()) if self.names.is_group(link_name) else None
        return _Carried(publisher=publisher, sets=sets, is_latched=is_latched, wanted_s=self._clock())

    def _send(self, carried: _Carried, member: int, writer: WriterOffer, sample: Sample) -> None:
        """Offer a sample to the link; of a group, when its set is complete."""
        records = [Record(member, writer.number, sample.sequence, sample.data)]
        source: int | None = writer.number
        if carried.sets is not None:
            with carried.lock:
                if (complete := carried.sets.add(records[0])) is None:
                    return
            records, source = complete, None
        carried.publisher.offer(pack(records), source=source, lifespan_ns=writer.lifespan_ns)

    def _drop(self, link_name: str) -> None:
        carried = self._carried.pop(link_name)
        carried.close_readers(carried.wanted)
        carried.publisher.destroy()
        if carried.sets is not None:
            self._incomplete += carried.sets.dropped


def has_header(msg_type: Any) -> bool:
    """Return whether the first field of a message class is a std_msgs/Header."""
    return next(iter(msg_type.get_fields_and_field_types().values()), "") == "std_msgs/Header"
