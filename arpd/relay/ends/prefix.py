"""The relay with one end: republishes what nodes on this host publish under a prefix, without chunks or envelopes."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from arpd.endpoint.node_publishers import NodePublishers
from arpd.endpoint.publisher import AdaptivePublisher
from arpd.model.endpoints import Overflow
from arpd.model.settings import DEFAULT_RELAY_DEPTH, RelaySettings
from arpd.relay.ends.outgoing import Carried, Outgoing
from arpd.relay.ends.types import is_bulk, message_class
from arpd.relay.status import prefix_line
from arpd.ros.runtime import ros_node

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.endpoint.writing_thread import WritingThread
    from arpd.relay.ends.offers import WriterOffer
    from arpd.ros.raw_reader import ReadingThread, Sample

log = logging.getLogger(__name__)
_LATCHED_DEPTH = 100  # of small samples, for late readers: of each of many writers the newest; tf2 reads as many
_LINGER_S = 10.0  # without a writer: a source may restart, and a loop whose source never comes must end

_MOST_TOPICS = 100
_MOST_LARGE = 8  # each costs threads, and discovery with every other participant


class Participants:
    """Nodes of one process, NAME, NAME_2 and so on, each with a participant of its own, made when a topic needs it.

    Whenever a participant gets or loses an endpoint, rmw_fastrtps sends the list of all its endpoints to every other
    participant. So the cost of a plan for a participant grows with the square of its topics. And writers of one
    participant wait for each other inside Fast DDS: while a picture of 0.9 MB left at 5 Mbit/s, a topic of 100 Hz in
    the same participant came 7 times a second, and in another one 100 times.

    Parameters
    ----------
    first : the process's own node

    Attributes
    ----------
    threads : of all nodes, as they are made
    """

    def __init__(self, first: Any) -> None:
        self._name = str(first.get_name())
        self.threads: list[ReadingThread | WritingThread] = []
        self._stack = ExitStack()
        self._nodes = {(False, 0): first}
        self._places: dict[str, tuple[bool, int]] = {}
        self.threads.append(NodePublishers.of(first).thread)

    def of(self, topic: str, *, is_large: bool) -> Any:
        """Return the node of a topic, the same at every call.

        Parameters
        ----------
        is_large : whether it has samples that others should not wait for
        """
        if topic not in self._places:
            number = sum(large is is_large for large, _ in self._places.values())
            self._places[topic] = is_large, number % _MOST_LARGE if is_large else number // _MOST_TOPICS
        if (place := self._places[topic]) not in self._nodes:
            # Nobody spins it: arpd's threads serve its publishers.
            name = f"{self._name}_{len(self._nodes) + 1}"
            self._nodes[place] = self._stack.enter_context(ros_node(name, context=Context()))
            self.threads.append(NodePublishers.of(self._nodes[place]).thread)
        return self._nodes[place]

    def close(self) -> None:
        """Destroy all nodes but the first."""
        self._stack.close()


class _Republished(Carried):
    def __init__(self, publisher: AdaptivePublisher, *, is_latched: bool) -> None:
        super().__init__(is_latched=is_latched)
        self._publisher = publisher

    def send(self, _topic: str, writer: WriterOffer, sample: Sample) -> None:
        self._publisher.pass_on(sample.data, writer.gid)

    def destroy(self) -> None:
        self._publisher.destroy()


class Prefixed(Outgoing):
    """Republishes each configured topic while it has writers, through an AdaptivePublisher.

    Parameters
    ----------
    node : looks at the graph and reads; nobody needs to spin it
    tell : called with the status line at every look

    Attributes
    ----------
    threads : none may hang; there may be more later
    """

    def __init__(self, node: Any, settings: RelaySettings, *, tell: Callable[[str], None]) -> None:
        self._participants, self._tell = Participants(node), tell
        self._inputs = {str(node.resolve_topic_name(topic)): topic for topic in settings.topic_names}
        self._outputs = {topic: str(node.resolve_topic_name(settings.prefix + topic)) for topic in settings.topic_names}
        super().__init__(node, name_of=self._inputs.get, carry=self._republish, settings=settings, linger_s=_LINGER_S)
        self.threads = self._participants.threads
        self.threads.append(self.thread)
        self._named: dict[str, str] = {}  # refusals that the log has

    def close(self) -> None:
        """Carry nothing any more."""
        super().close()
        self._participants.close()

    def look(self) -> None:
        """Follow the graph, and tell the status."""
        super().look()
        objections = {topic: words for topic in self._topics if (words := self._objection(topic))}
        self.forget(objections)
        self.follow(self.offers.keys() - objections)
        refused = objections | self.refused
        for topic, reason in refused.items() - self._named.items():
            log.error("cannot relay %s: %s; the other topics are not affected", topic, reason)
        self._named = refused
        ignored = {
            topic: ", ".join(each for each in types if each != self.offers[topic].type_name)
            for topic, types in self.several_types().items()
            if topic not in refused
        }
        silent = [topic for topic in self._outputs if topic not in refused and topic not in self.offers]
        self._tell(prefix_line(topics=len(self._outputs), silent=silent, refused=refused, ignored=ignored))

    def _objection(self, topic: str) -> str:
        """Return why a topic must not be carried, in words; empty if it may."""
        output = self._outputs[topic]
        if topic not in self.offers:
            types = self._topics[topic].types
            return f"it has more than one type: {', '.join(types)}" if len(types) > 1 else ""
        if output in self._inputs:
            return f"its output {output} is carried too, so messages would loop; remove the remapping rule"
        readers = {reader.node for reader in self._view.readers(output) if reader.node}
        if loop := sorted({writer.node for writer in self.offers[topic].writers} & readers):
            return f"{', '.join(loop)} reads {output} and publishes it, so messages would loop"
        return ""

    def _republish(self, topic: str, *, is_latched: bool) -> _Republished:
        kind = message_class(type_name := self.offers[topic].type_name)
        log.info("relaying %s to %s (%s)", topic, self._outputs[topic], type_name)
        # Latched topics (/map, /tf_static) stay latched: late joiners on the far side would miss them otherwise.
        durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE
        least = _LATCHED_DEPTH if is_latched and not is_bulk(kind) else DEFAULT_RELAY_DEPTH
        publisher = AdaptivePublisher(
            self._participants.of(topic, is_large=is_bulk(kind)),
            kind,
            self._settings.prefix + topic,
            QoSProfile(depth=self._settings.depths.get(topic) or least, durability=durability),
            overflow=Overflow.QUEUE if topic in self._settings.queued else Overflow.LATEST,
        )
        return _Republished(publisher, is_latched=is_latched)
