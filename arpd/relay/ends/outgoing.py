"""Topics that somebody wants elsewhere: their samples from this side's writers, each to a publisher of its own."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.relay.ends.offers import TopicOffer, WriterOffer
from arpd.relay.ends.topic_readers import Surveyed, TopicReaders
from arpd.relay.ends.types import UnknownTypeError, message_class
from arpd.ros.graph import GraphView
from arpd.ros.names import is_full_name
from arpd.ros.raw_reader import ReadingThread, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings

_NAMED_AS_GROUP = "a group of topics has this name; give the group another one under relay.groups"
_REST_S = 0.0015  # most that a sample waits behind others; of an arm's thousand a second several are read in a turn
_PLANS_S = 5.0  # between changes of the plans that it tells: each is a message on the link


class Carried:
    """One topic, or one group of topics, that is carried; its heirs say by what.

    Parameters
    ----------
    is_latched : whether a writer was latched when it was made

    Attributes
    ----------
    planned : DEPTH and DEADLINE that the daemon has planned for it, 0 = none (samples, ns)
    wanted, wanted_s : its topics that are wanted, and when one was last (s)
    """

    def __init__(self, *, is_latched: bool) -> None:
        self.is_latched = is_latched
        self.planned = 0, 0
        self.wanted: set[str] = set()
        self.wanted_s = 0.0
        self.types: dict[str, str] = {}
        self.readers: dict[str, TopicReaders] = {}

    def close_readers(self, topics: Collection[str]) -> None:
        """Destroy the readers of these topics."""
        for topic in self.readers.keys() & topics:
            self.readers.pop(topic).destroy()

    def is_heard(self) -> bool:
        """Return whether its topics may be read: a history would be lost before its own reader is there."""
        return True

    def check(self, kind: Any) -> None:
        """Raise ValueError where samples of this message class cannot be sent on."""

    def expect(self, topics: Collection[str]) -> None:
        """Take note that samples of these topics will come, and of no other."""

    def send(self, topic: str, writer: WriterOffer, sample: Sample) -> None:
        """Send a sample on, in the reading thread."""
        raise NotImplementedError

    def miss(self, samples: int) -> None:
        """Take note that this computer was too busy to read so many samples, in the reading thread."""

    def destroy(self) -> None:
        """Send no more."""
        raise NotImplementedError


class Outgoing:
    """Carries the wanted topics while they are offered here; those that cannot be carried are named, and others go on.

    Parameters
    ----------
    name_of : returns the name by which a topic is offered and wanted, None = it is not; from its local name
    carry : makes what carries the topics of this name on the link; whether one is latched
    linger_s : how long a topic stays that nobody wants, or offers, any more (s)
    node_name : returns the name by which a node is offered, from its local name

    Attributes
    ----------
    offers : topics of this side that may be carried
    carried : those that are, by the name on the link
    refused : wanted topics that cannot be carried, and why
    """

    def __init__(
        self,
        node: Node,
        *,
        name_of: Callable[[str], str | None],
        carry: Callable[..., Carried],
        settings: RelaySettings,
        linger_s: float,
        node_name: Callable[[str], str] = str,
    ) -> None:
        self._node, self._name_of, self._node_name = node, name_of, node_name
        self._carry, self._settings = carry, settings
        self._linger_s = linger_s
        self._groups = {topic: group.name for group in settings.groups for topic in group.topics}
        self._view = GraphView.of(node)
        self._changes = -1  # of the graph, when its topics were read last
        self._topics: dict[str, Surveyed] = {}
        self._planned: dict[str, tuple[int, int]] = {}  # that it tells, by the name on the link
        self._planned_s = 0.0  # when it may tell others
        self.thread = ReadingThread(rest_s=_REST_S)
        self.offers: dict[str, TopicOffer] = {}
        self.carried: dict[str, Carried] = {}
        self.refused: dict[str, str] = {}

    def look(self) -> None:
        """Follow the graph."""
        before, self._changes = self._changes, self._view.look()
        if has_changed := self._changes != before:
            names = {self._name_of(local): local for local in sorted(self._view.types) if is_full_name(local)}
            self._topics = {
                name: self._topics.get(name) or Surveyed(self._view, local)
                for name, local in names.items()
                if name is not None
            }
        for topic in self._topics.values():
            topic.look(has_changed=has_changed)
        planned = {name: each.planned for name, each in self.carried.items() if any(each.planned)}
        if planned != self._planned and (now_s := time.monotonic()) >= self._planned_s:
            self._planned, self._planned_s = planned, now_s + _PLANS_S
        offers = {name: self._offer(name, found) for name, found in self._topics.items() if found.writers}
        if offers != self.offers:  # else the same objects, which compare at once
            self.offers = offers

    def _offer(self, name: str, found: Surveyed) -> TopicOffer:
        link_name = self._groups.get(name, name)
        depth, deadline_ns = self._planned.get(link_name, (0, 0))
        readers = self.carried[link_name].readers.get(name) if link_name in self.carried else None
        writers = tuple(
            replace(
                each,
                node=self._node_name(each.node),
                is_alive=each.is_manual and readers is not None and readers.are_alive(each),
            )
            for each in found.writers
        )
        return TopicOffer(
            type_name=found.type_name,
            type_hash=found.type_hash,
            writers=writers,
            link_name=link_name,
            planned_depth=depth,
            planned_deadline_ns=deadline_ns,
        )

    def several_types(self) -> dict[str, tuple[str, ...]]:
        """Return the types of the topics that have more than one."""
        return {name: topic.types for name, topic in self._topics.items() if len(topic.types) > 1}

    def follow(self, wants: Collection[str]) -> None:
        """Carry the wanted topics that are offered, and no other."""
        offered, wanted = self.offers.keys() & wants, defaultdict[str, set[str]](set)
        self.refused = dict.fromkeys((offered & {*self._groups.values()}) - self._groups.keys(), _NAMED_AS_GROUP)
        for topic in offered - self.refused.keys():
            wanted[self.offers[topic].link_name].add(topic)
        now_s = time.monotonic()
        for link_name, known in list(self.carried.items()):
            if link_name not in wanted and now_s - known.wanted_s > self._linger_s:
                self._drop(link_name)
        for link_name, topics in wanted.items():
            is_latched = any(writer.is_latched for topic in topics for writer in self.offers[topic].writers)
            types = {topic: self.offers[topic].type_name for topic in topics}
            carried = self.carried.get(link_name)
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
                    carried = self.carried[link_name] = self._carry(link_name, is_latched=is_latched)
            except (UnknownTypeError, RuntimeError, ValueError) as fault:
                self.refused |= dict.fromkeys(topics, str(fault))
            else:
                carried.close_readers(carried.wanted - topics)
                carried.wanted, carried.wanted_s = topics, now_s
        self.step()

    def step(self) -> None:
        """Open the readers of topics that may be read."""
        for carried in self.carried.values():
            if carried.readers or carried.is_heard():
                for topic in carried.wanted:
                    if topic in self.offers and topic not in self.refused:
                        self._read(carried, topic, self.offers[topic])
            carried.expect(carried.wanted - self.refused.keys())

    def forget(self, link_names: Collection[str]) -> None:
        """Carry none of these at once."""
        for link_name in self.carried.keys() & link_names:
            self._drop(link_name)

    def forget_latched(self) -> None:
        """Begin again with latched topics: the other end is another process now, and lacks their histories.

        The other topics stay as they are, because the new process may hear them already: it asks for what it reads a
        second after its start, and new writers would cost it the samples of their match.
        """
        self.forget([link_name for link_name, carried in self.carried.items() if carried.is_latched])

    def close(self) -> None:
        """Carry nothing any more."""
        self.forget([*self.carried])
        self.thread.stop()

    def _read(self, carried: Carried, topic: str, offer: TopicOffer) -> None:
        try:
            if topic not in carried.readers:
                carried.types[topic] = offer.type_name
                kind = message_class(offer.type_name)
                carried.check(kind)
                carried.readers[topic] = TopicReaders(
                    self._node,
                    self._topics[topic],
                    kind,
                    thread=self.thread,
                    deliver=partial(carried.send, topic),
                    on_missed=carried.miss,
                    depth=self._settings.depths.get(topic),
                    # Those of a group wait for each other.
                    is_kept=topic in self._settings.queued or topic in self._groups,
                )
            carried.readers[topic].follow(offer.writers)
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            self.refused[topic] = str(fault)

    def _drop(self, link_name: str) -> None:
        carried = self.carried.pop(link_name)
        carried.close_readers(carried.wanted)
        carried.destroy()
