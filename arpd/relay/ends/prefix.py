"""The relay with one end: republishes what nodes on this host publish under a prefix, without chunks or envelopes."""

from __future__ import annotations

import logging
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSDurabilityPolicy, QoSProfile

from arpd.endpoint.publisher import AdaptivePublisher
from arpd.host.notify import Watchdog
from arpd.model.endpoints import Overflow
from arpd.model.settings import DEFAULT_RELAY_DEPTH
from arpd.relay.depths import BULK_BYTES
from arpd.relay.ends.participants import Participants
from arpd.relay.ends.survey import Survey
from arpd.relay.ends.topic_readers import TopicReaders
from arpd.relay.ends.types import UnknownTypeError, expected_bytes, message_class
from arpd.relay.status import prefix_line
from arpd.ros.graph_view import GraphView
from arpd.ros.raw_reader import ReadingThread, Sample
from arpd.ros.runtime import ros_node, serve_until

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from arpd.host.addresses import Addresses
    from arpd.host.notify import Notifier
    from arpd.model.settings import RelaySettings
    from arpd.relay.ends.survey import Surveyed
    from arpd.relay.offers import WriterOffer

log = logging.getLogger(__name__)
_LOOK_S = 0.5
_LINGER = 20  # looks without a writer: 10 s let a source restart, and end a loop whose source never comes


@dataclass(slots=True)
class _Carried:
    type_name: str
    publisher: AdaptivePublisher
    readers: TopicReaders
    silent: int = 0  # looks since it had a writer


class Prefixed:
    """Carries each configured topic while it has writers; one that cannot be carried is named, and the others go on.

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
        self._node, self._settings, self._participants, self._on_change = node, settings, participants, on_change
        self._inputs = {topic: str(node.resolve_topic_name(topic)) for topic in settings.topic_names}
        self._outputs = {topic: str(node.resolve_topic_name(settings.prefix + topic)) for topic in settings.topic_names}
        self._view = GraphView.of(node)
        self._survey = Survey(node, is_of_interest=frozenset(self._inputs.values()).__contains__)
        self._thread = ReadingThread()
        participants.parts.append(lambda: self._thread.finished_s)
        self._carried: dict[str, _Carried] = {}
        self._refused: dict[str, str] = {}
        self._status = ""

    def close(self) -> None:
        """Carry nothing any more."""
        for topic in list(self._carried):
            self._drop(topic)
        self._thread.stop()

    def look(self) -> None:
        """Follow the graph, and tell the status if it has changed."""
        self._survey.look()
        silent, refused, ignored = [], {}, {}
        for topic, name in self._inputs.items():
            surveyed = self._survey.topics.get(name)
            if surveyed is None or not surveyed.types:
                silent.append(topic)
                self._rest(topic)
                continue
            if reason := self._objection(topic, surveyed) or self._follow(topic, surveyed):
                refused[topic] = reason
            elif others := [each for each in surveyed.types if each != surveyed.type_name]:
                ignored[topic] = ", ".join(others)
        for topic, reason in refused.items() - self._refused.items():
            log.error("cannot relay %s: %s; the other topics are not affected", topic, reason)
        self._refused = refused
        status = prefix_line(topics=len(self._inputs), silent=silent, refused=refused, ignored=ignored)
        if status != self._status:
            self._status = status
            self._on_change(status)

    def _rest(self, topic: str) -> None:
        """Keep a topic without a writer for a while, in case its source returns."""
        if (carried := self._carried.get(topic)) is not None:
            carried.silent += 1
            if carried.silent > _LINGER:
                self._drop(topic)

    def _objection(self, topic: str, surveyed: Surveyed) -> str:
        """Return why a topic must not be carried, in words, and carry it no more; empty if it may."""
        reason, output = "", self._outputs[topic]
        if not surveyed.type_name:
            reason = f"it has more than one type: {', '.join(surveyed.types)}"
        elif output in self._inputs.values():
            reason = f"its output {output} is carried too, so messages would loop; remove the remapping rule"
        elif loop := sorted({each.node for each in surveyed.writers.values()} & self._readers_of(output)):
            reason = f"{', '.join(loop)} reads {output} and publishes it, so messages would loop"
        if reason:
            self._drop(topic)
        return reason

    def _readers_of(self, output: str) -> set[str]:
        return {reader.node for reader in self._view.readers(output) if reader.node}

    def _follow(self, topic: str, surveyed: Surveyed) -> str:
        """Carry the topic as its writers are now; return what failed, in words."""
        carried = self._carried.get(topic)
        if carried is not None and carried.type_name != surveyed.type_name:
            log.info("%s returned as %s; it was %s", topic, surveyed.type_name, carried.type_name)
            # The next look carries it. With a new writer at once, a far reader never matched in 4 of 27 runs.
            self._drop(topic)
            return ""
        try:
            if carried is None:
                carried = self._carried[topic] = self._carry(topic, surveyed)
                log.info("relaying %s to %s (%s)", topic, self._outputs[topic], surveyed.type_name)
            carried.silent = 0
            carried.readers.follow(surveyed.writers.values())
        except (UnknownTypeError, RuntimeError, ValueError) as fault:
            return str(fault)  # the next look tries again
        return ""

    def _drop(self, topic: str) -> None:
        if (carried := self._carried.pop(topic, None)) is not None:
            carried.readers.destroy()
            carried.publisher.destroy()

    def _carry(self, topic: str, surveyed: Surveyed) -> _Carried:
        kind = message_class(surveyed.type_name)
        # Latched topics (/map, /tf_static) stay latched: late joiners on the far side would miss them otherwise.
        is_latched = any(writer.is_latched for writer in surveyed.writers.values())
        depth = self._settings.depths.get(topic)
        publisher = AdaptivePublisher(
            self._participants.of(topic, is_large=expected_bytes(kind) >= BULK_BYTES),
            kind,
            self._settings.prefix + topic,
            QoSProfile(
                depth=depth or DEFAULT_RELAY_DEPTH,
                durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
            ),
            overflow=Overflow.QUEUE if topic in self._settings.queued else Overflow.LATEST,
        )

        def deliver(_writer: WriterOffer, sample: Sample) -> None:
            publisher.pass_on(sample.data)

        readers = TopicReaders(
            self._node,
            self._inputs[topic],
            kind,
            survey=self._survey,
            thread=self._thread,
            deliver=deliver,
            depth=depth,
        )
        return _Carried(type_name=surveyed.type_name, publisher=publisher, readers=readers)


def run_prefix(
    settings: RelaySettings, *, node_name: str, notifier: Notifier, stopping: threading.Event, addresses: Addresses
) -> None:
    """Run the relay until ``stopping`` is set.

    Raises
    ------
    LinkError
        If only a new process can use the link's address.
    """
    with (
        ros_node(node_name) as node,
        closing(Participants(node)) as participants,
        closing(Prefixed(node, settings, participants=participants, on_change=notifier.status)) as relay,
    ):
        heartbeat = Watchdog(notifier, parts=participants.parts)
        notifier.ready()
        try:
            serve_until(stopping, heartbeat=heartbeat, addresses=addresses, step=relay.look, every_s=_LOOK_S)
        finally:
            notifier.stopping()
