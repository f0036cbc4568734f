"""The relay with one end: republishes what nodes on this host publish under a prefix, without chunks or envelopes."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from arpd.endpoint.node_publishers import NodePublishers
from arpd.endpoint.publisher import AdaptivePublisher
from arpd.model.endpoints import Overflow
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.ends.offers import TopicOffer
from arpd.relay.ends.outgoing import Outgoing
from arpd.relay.ends.survey import Survey
from arpd.relay.ends.types import is_bulk, message_class
from arpd.relay.status import prefix_line
from arpd.ros.graph_view import GraphView
from arpd.ros.raw_reader import ReadingThread, Sample
from arpd.ros.runtime import ros_node

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.settings import RelaySettings
    from arpd.relay.ends.survey import Surveyed, Writer

log = logging.getLogger(__name__)
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
    parts : its threads
    """

    def __init__(self, first: Any) -> None:
        self._name = str(first.get_name())
        self.parts: list[Callable[[], float]] = []
        self._stack = ExitStack()
        self._nodes = {(0, False): first}
        self._of: dict[tuple[str, bool], Any] = {}
        self._watch(first)

    def of(self, topic: str, *, is_large: bool) -> Any:
        """Return the node of a topic, the same at every call.

        Parameters
        ----------
        is_large : whether it has samples that others should not wait for
        """
        if (topic, is_large) not in self._of:
            number = sum(other is is_large for _, other in self._of)
            place = number % _MOST_LARGE if is_large else number // _MOST_TOPICS, is_large
            if place not in self._nodes:
                # Nobody spins it: arpd's threads serve its publishers.
                name = f"{self._name}_{len(self._nodes) + 1}"
                self._nodes[place] = self._stack.enter_context(ros_node(name, context=Context()))
                self._watch(self._nodes[place])
            self._of[topic, is_large] = self._nodes[place]
        return self._of[topic, is_large]

    def close(self) -> None:
        """Destroy all nodes but the first."""
        self._stack.close()

    def _watch(self, node: Any) -> None:
        self.parts.append(partial(getattr, NodePublishers.of(node).thread, "finished_s"))


class _Publisher(AdaptivePublisher):
    """Publishes serialized samples under the prefix."""

    def send(self, _topic: str, _writer: Writer, sample: Sample) -> None:
        """Send a sample on, in the reading thread."""
        self.pass_on(sample.data)


class Prefixed(Outgoing[_Publisher]):
    """Republishes each configured topic while it has writers, through an AdaptivePublisher.

    Parameters
    ----------
    node : looks at the graph and reads; nobody needs to spin it
    settings : topics and prefix
    participants : nodes that publish; `close` does not close them
    on_change : called with the status line whenever it changes
    """

    def __init__(
        self, node: Any, settings: RelaySettings, *, participants: Participants, on_change: Callable[[str], None]
    ) -> None:
        self._participants, self._on_change = participants, on_change
        self._inputs = {topic: str(node.resolve_topic_name(topic)) for topic in settings.topic_names}
        self._outputs = {topic: str(node.resolve_topic_name(settings.prefix + topic)) for topic in settings.topic_names}
        self._view = GraphView.of(node)
        super().__init__(
            node=node,
            survey=Survey(node, is_of_interest=frozenset(self._inputs.values()).__contains__),
            thread=ReadingThread(),
            local_name=self._inputs.__getitem__,
            settings=settings,
            linger_s=_LINGER_S,
        )
        participants.parts.append(lambda: self._thread.finished_s)
        self._named: dict[str, str] = {}  # refusals that the log has
        self._status = ""

    def close(self) -> None:
        """Carry nothing any more."""
        self.forget()
        self._thread.stop()

    def look(self) -> None:
        """Follow the graph, and tell the status if it has changed."""
        self._survey.look()
        silent, objections, ignored, offers = [], {}, {}, {}
        for topic, name in self._inputs.items():
            surveyed = self._survey.topics.get(name)
            if surveyed is None or not surveyed.types:
                silent.append(topic)
            elif reason := self._objection(topic, surveyed):
                objections[topic] = reason
            else:
                offers[topic] = TopicOffer(
                    type_name=surveyed.type_name, writers=(*surveyed.writers.values(),), link_name=topic
                )
                if others := [each for each in surveyed.types if each != surveyed.type_name]:
                    ignored[topic] = ", ".join(others)
        self.forget(objections)
        self.follow(offers, offers)
        refused = objections | self.refused
        for topic, reason in refused.items() - self._named.items():
            log.error("cannot relay %s: %s; the other topics are not affected", topic, reason)
        self._named = refused
        ignored = {topic: types for topic, types in ignored.items() if topic not in refused}
        status = prefix_line(topics=len(self._inputs), silent=silent, refused=refused, ignored=ignored)
        if status != self._status:
            self._status = status
            self._on_change(status)

    def _objection(self, topic: str, surveyed: Surveyed) -> str:
        """Return why a topic must not be carried, in words; empty if it may."""
        output = self._outputs[topic]
        if not surveyed.type_name:
            return f"it has more than one type: {', '.join(surveyed.types)}"
        if output in self._inputs.values():
            return f"its output {output} is carried too, so messages would loop; remove the remapping rule"
        readers = {reader.node for reader in self._view.readers(output) if reader.node}
        if loop := sorted({each.node for each in surveyed.writers.values()} & readers):
            return f"{', '.join(loop)} reads {output} and publishes it, so messages would loop"
        return ""

    def _publisher(self, link_name: str, type_name: str, *, is_latched: bool) -> _Publisher:
        kind = message_class(type_name)
        log.info("relaying %s to %s (%s)", link_name, self._outputs[link_name], type_name)
        # Latched topics (/map, /tf_static) stay latched: late joiners on the far side would miss them otherwise.
        durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE
        return _Publisher(
            self._participants.of(link_name, is_large=is_bulk(kind)),
            kind,
            self._settings.prefix + link_name,
            QoSProfile(depth=self._settings.depths.get(link_name) or DEFAULT_RELAY_DEPTH, durability=durability),
            overflow=Overflow.QUEUE if link_name in self._settings.queued else Overflow.LATEST,
        )
