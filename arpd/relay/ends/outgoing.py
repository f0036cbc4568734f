"""Topics that somebody wants elsewhere: their samples from this side's writers, each to a publisher of its own."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from arpd.relay.ends.topic_readers import TopicReaders
from arpd.relay.ends.types import UnknownTypeError, message_class

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings
    from arpd.relay.ends.offers import TopicOffer
    from arpd.relay.ends.survey import Survey, Writer
    from arpd.ros.raw_reader import ReadingThread, Sample


class Publisher(Protocol):
    """What the samples of a topic, or of a group of topics, are sent on by."""

    def send(self, topic: str, writer: Writer, sample: Sample) -> None:
        """Send a sample on, in the reading thread."""

    def destroy(self) -> None:
        """Send no more."""


P = TypeVar("P", bound=Publisher)


@dataclass(slots=True)
class Carried(Generic[P]):
    """One topic, or one group of topics.

    Parameters
    ----------
    publisher : what it is sent on by
    is_latched : whether a writer was latched when it was made
    wanted, wanted_s : its topics that are wanted, and when one was last (s)
    types : of its topics
    readers : of its topics
    """

    publisher: P
    is_latched: bool
    wanted_s: float
    wanted: set[str] = field(default_factory=set)
    types: dict[str, str] = field(default_factory=dict)
    readers: dict[str, TopicReaders] = field(default_factory=dict)

    def close_readers(self, topics: Collection[str]) -> None:
        """Destroy the readers of these topics."""
        for topic in self.readers.keys() & topics:
            self.readers.pop(topic).destroy()


class Outgoing(Generic[P]):
    """Carries the wanted topics while they are offered here; those that cannot be carried are named, and others go on.

    What a sample crosses by is for its heirs to say.

    Parameters
    ----------
    node : reads
    survey : topics of this side and their writers
    thread : takes the samples
    local_name : returns the local name of a topic
    settings : groups, overflow and depths
    linger_s : how long a topic stays that nobody wants, or offers, any more (s)

    Attributes
    ----------
    refused : wanted topics that cannot be carried, and why
    """

    def __init__(
        self,
        *,
        node: Node,
        survey: Survey,
        thread: ReadingThread,
        local_name: Callable[[str], str],
        settings: RelaySettings,
        linger_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._survey, self._thread, self._local_name = node, survey, thread, local_name
        self._settings, self._linger_s, self._clock = settings, linger_s, clock
        self._groups = {topic: group.name for group in settings.groups for topic in group.topics}
        self._carried: dict[str, Carried[P]] = {}  # by the name on the link
        self.refused: dict[str, str] = {}

    def link_name(self, topic: str) -> str:
        """Return the name under which a topic is carried: its group's, or its own."""
        return self._groups.get(topic, topic)

    def follow(self, wants: Collection[str], offers: Mapping[str, TopicOffer]) -> None:
        """Carry the wanted topics that are offered, and no other."""
        wanted: dict[str, set[str]] = {}
        for topic in offers.keys() & wants:
            wanted.setdefault(self.link_name(topic), set()).add(topic)
        now_s = self._clock()
        for link_name, known in list(self._carried.items()):
            if link_name in wanted:
                known.wanted_s = now_s
            elif now_s - known.wanted_s > self._linger_s:
                self._drop(link_name)
        self.refused = {}
        for link_name, topics in wanted.items():
            is_latched = any(writer.is_latched for topic in topics for writer in offers[topic].writers)
            types = {topic: offers[topic].type_name for topic in topics}
            carried = self._carried.get(link_name)
            if carried is not None and (
                (is_latched and not carried.is_latched)
                or any(types.get(topic, type_name) != type_name for topic, type_name in carried.types.items())
            ):
                # A latched writer's history, or another type, wants another publisher. The next look carries it. With a
                # new writer at once, a far reader never matched in 4 of 27 runs.
                self._drop(link_name)
                continue
            try:
                if carried is None:
                    publisher = self._publisher(link_name, types[min(topics)], is_latched=is_latched)
                    carried = self._carried[link_name] = Carried(publisher, is_latched, now_s)
            except (UnknownTypeError, RuntimeError, ValueError) as fault:
                self.refused |= dict.fromkeys(topics, str(fault))
            else:
                carried.close_readers(carried.wanted - topics)
                carried.wanted = topics
        self.step(offers)

    def step(self, offers: Mapping[str, TopicOffer]) -> None:
        """Open the readers of topics whose publisher has found its reader: a history would be lost otherwise."""
        for carried in self._carried.values():
            if carried.readers or self._is_heard(carried.publisher):
                for topic in (carried.wanted & offers.keys()) - self.refused.keys():
                    self._read(carried, topic, offers[topic])

    def forget(self, link_names: Collection[str] | None = None) -> None:
        """Carry none of these at once, or nothing at all."""
        for link_name in [*self._carried] if link_names is None else self._carried.keys() & link_names:
            self._drop(link_name)

    def _read(self, carried: Carried[P], topic: str, offer: TopicOffer) -> None:
        try:
            if topic not in carried.readers:
                carried.types[topic] = offer.type_name
                kind = message_class(offer.type_name)
                self._check(carried, kind)
                carried.readers[topic] = TopicReaders(
                    self._node,
                    self._local_name(topic),
                    kind,
                    survey=self._survey,
                    thread=self._thread,
                    deliver=partial(carried.publisher.send, topic),
                    depth=self._settings.depths.get(topic),
                    clock=self._clock,
                )
            carried.readers[topic].follow(offer.writers)
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            self.refused[topic] = str(fault)

    def _drop(self, link_name: str) -> None:
        carried = self._carried.pop(link_name)
        carried.close_readers(carried.wanted)
        carried.publisher.destroy()

    # -- what heirs say

    def _publisher(self, link_name: str, type_name: str, *, is_latched: bool) -> P:
        raise NotImplementedError

    def _is_heard(self, _publisher: P) -> bool:
        return True

    def _check(self, carried: Carried[P], kind: Any) -> None:
        """Raise ValueError where samples of this message class cannot be sent on."""
