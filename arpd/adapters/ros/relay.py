"""`arpd relay`: republishes topics of nodes whose code is not yours through AdaptivePublishers."""

from __future__ import annotations

import logging
import platform
import re
import threading
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from arpd.adapters.config.domain import local_domain
from arpd.adapters.config.load import load_settings
from arpd.adapters.host.addresses import Addresses
from arpd.adapters.host.interface import likeliest_interface
from arpd.adapters.ros.runtime import best_executor, ros_node, serve_until, stop_on_signals
from arpd.adapters.systemd.journal import configure_logging
from arpd.adapters.systemd.notify import Notifier, Watchdog
from arpd.apply.relay_routes import circle, own_output
from arpd.apply.relay_status import RelayStatus
from arpd.model.settings import AUTO, DEFAULT_RELAY_DEPTH, Overflow

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.adapters.ros.ends.raw_reader import Sample
    from arpd.adapters.ros.ends.survey import Surveyed
    from arpd.adapters.ros.ends.topic_readers import TopicReaders
    from arpd.adapters.ros.participants import Participants
    from arpd.adapters.ros.publisher import AdaptivePublisher
    from arpd.apply.relay.offers import WriterOffer
    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)

_LOOK_S = 0.5
_EVERY_LOOK = 10  # every tenth look reads who reads the output, even when their number is unchanged
_KEEP_LOOKS = 20  # 10 s: enough for a source to restart, and an end for a loop whose source never comes


@dataclass(slots=True)
class _Carried:
    """A topic that is relayed."""

    type_name: str
    publisher: AdaptivePublisher
    readers: TopicReaders
    output_readers: frozenset[str] = frozenset()
    counted: int = -1  # of those, when their names were read

    def destroy(self) -> None:
        self.readers.destroy()
        self.publisher.destroy()


class Relay:
    """Reads each configured topic, and republishes its samples, unchanged, under the prefix.

    It looks at the graph again and again. A topic is carried once it has a publisher; a topic that returns with another
    type is carried with that type. A topic that cannot be carried is named, and the others go on.

    Parameters
    ----------
    node : rclpy node it lives in
    settings : topics and prefix
    participants : nodes of the relay, which publish and read the topics; `close` does not close them
    on_change : called with the status at the start and whenever it changes
    """

    def __init__(
        self,
        node: Any,
        settings: RelaySettings,
        *,
        participants: Participants,
        on_change: Callable[[RelayStatus], None],
    ) -> None:
        from rclpy.clock import Clock, ClockType  # noqa: PLC0415 - ROS is checked in ros_node

        from arpd.adapters.ros.ends.raw_reader import ReadingThread  # noqa: PLC0415
        from arpd.adapters.ros.ends.survey import Survey  # noqa: PLC0415

        self._node = node
        self._settings = settings
        self._participants = participants
        self._on_change = on_change
        self._inputs = {topic: str(node.resolve_topic_name(topic)) for topic in settings.topics}
        self._survey = Survey(node, own=b"", is_of_interest=frozenset(self._inputs.values()).__contains__)
        self._thread = ReadingThread()
        participants.parts.append(lambda: self._thread.finished_s)
        self._carried: dict[str, _Carried] = {}
        self._refused: dict[str, str] = {}
        self._failed: dict[str, str] = {}  # topic → type that could not be carried
        self._looks = 0
        self._silent = dict.fromkeys(settings.topics, 0)  # topic → looks since it had a publisher
        self._once: set[str] = set()  # topics that were carried before
        self._outputs: dict[str, str] = {}  # topic → name it is republished under
        for topic in settings.topics:
            output = str(node.resolve_topic_name(settings.prefix + topic))
            if refusal := own_output(topic, prefix=settings.prefix, output=output):
                self._refuse(topic, refusal)
            else:
                self._outputs[topic] = output
        self._status = self.status()
        on_change(self._status)
        # Steady time, so that a paused simulation does not stop the relay from following the graph.
        node.create_timer(_LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Carry nothing any more."""
        for topic in list(self._carried):
            self._drop(topic)
        self._thread.stop()

    def status(self) -> RelayStatus:
        """Return what is carried, and what is not and why."""
        silent = [topic for topic in self._settings.topics if topic in self._silent and topic not in self._refused]
        return RelayStatus(
            topics=self._settings.topics,
            flowing=tuple(topic for topic in self._carried if topic not in self._silent),
            unpublished=tuple(topic for topic in silent if topic not in self._once),
            gone=tuple(topic for topic in silent if topic in self._once),
            refused=tuple(self._refused.items()),
            ignored=tuple((topic, words) for topic in self._carried if (words := self._ignored(topic))),
        )

    def _ignored(self, topic: str) -> str:
        surveyed = self._survey.topics.get(self._inputs[topic])
        return ", ".join(each for each in surveyed.types if each != surveyed.type_name) if surveyed is not None else ""

    def _look(self) -> None:
        self._looks += 1
        self._survey.look()
        for topic in self._outputs:
            surveyed = self._survey.topics.get(self._inputs[topic])
            if surveyed is None or not surveyed.types:
                self._rest(topic)
            else:
                self._silent.pop(topic, None)
                self._follow(topic, surveyed)
        if (status := self.status()) != self._status:
            self._status = status
            self._on_change(status)

    def _rest(self, topic: str) -> None:
        """Keep a topic without a publisher for a while, in case its source returns, then drop it."""
        self._silent[topic] = self._silent.get(topic, 0) + 1
        self._refused.pop(topic, None)
        self._failed.pop(topic, None)
        if self._silent[topic] > _KEEP_LOOKS:
            self._drop(topic)

    def _follow(self, topic: str, surveyed: Surveyed) -> None:
        """Carry the topic as its writers are now."""
        carried, type_name = self._carried.get(topic), surveyed.type_name
        if reason := self._objection(topic, surveyed, carried):
            self._drop(topic)
            self._refuse(topic, reason)
        elif carried is not None and carried.type_name != type_name:
            log.info("%s returned as %s; it was %s", topic, type_name, carried.type_name)
            self._drop(topic)
            # The next look carries it. With a new writer at once, a far reader never matched in 4 of 27 runs.
        elif self._failed.get(topic) != type_name:
            self._carry_on(topic, surveyed, carried)

    def _objection(self, topic: str, surveyed: Surveyed, carried: _Carried | None) -> str:
        """Return why a topic cannot be carried, in words; empty if it can."""
        if not surveyed.type_name:
            return f"it has more than one type: {', '.join(surveyed.types)}"
        return circle(
            {writer.node for writer in surveyed.writers.values()},
            carriers=self._participants.names,
            output=self._outputs[topic],
            output_readers=self._output_readers(topic, carried),
        )

    def _output_readers(self, topic: str, carried: _Carried | None) -> frozenset[str]:
        """Return the names of the nodes that read what is republished."""
        from arpd.adapters.ros.graph import NOT_NAMED_YET, node_name_of  # noqa: PLC0415 - it imports ROS

        counted = -1 if carried is None else carried.publisher.get_subscription_count()
        if carried is not None and carried.counted == counted and self._looks % _EVERY_LOOK:
            return carried.output_readers
        names = {node_name_of(info) for info in self._node.get_subscriptions_info_by_topic(self._outputs[topic])}
        readers = frozenset(name for name in names if NOT_NAMED_YET not in name)
        if carried is not None:
            carried.output_readers, carried.counted = readers, counted if len(readers) == len(names) else -1
        return readers

    def _carry_on(self, topic: str, surveyed: Surveyed, carried: _Carried | None) -> None:
        from arpd.adapters.ros.ends.types import UnknownTypeError  # noqa: PLC0415 - it imports ROS

        try:
            if carried is None:
                carried = self._carried[topic] = self._carry(topic, surveyed)
                self._once.add(topic)
                log.info("relaying %s to %s (%s)", topic, carried.publisher.topic_name, surveyed.type_name)
            carried.readers.follow(surveyed.writers.values())
        except UnknownTypeError as error:
            self._failed[topic] = surveyed.type_name  # not imported again before the type changes
            self._refuse(topic, str(error))
        except (RuntimeError, ValueError) as error:
            self._refuse(topic, f"the middleware says: {error}")  # the next look tries again
        else:
            self._refused.pop(topic, None)
            self._failed.pop(topic, None)

    def _refuse(self, topic: str, reason: str) -> None:
        if self._refused.get(topic) != reason:
            log.error("cannot relay %s: %s; the other topics are not affected", topic, reason)
        self._refused[topic] = reason

    def _drop(self, topic: str) -> None:
        if (carried := self._carried.pop(topic, None)) is not None:
            carried.destroy()
        self._failed.pop(topic, None)

    def _carry(self, topic: str, surveyed: Surveyed) -> _Carried:
        from rclpy.qos import QoSDurabilityPolicy, QoSProfile  # noqa: PLC0415 - ROS is checked in ros_node

        from arpd.adapters.ros.ends.topic_readers import TopicReaders  # noqa: PLC0415
        from arpd.adapters.ros.ends.types import expected_bytes, message_class  # noqa: PLC0415
        from arpd.adapters.ros.publisher import AdaptivePublisher  # noqa: PLC0415
        from arpd.apply.relay.depths import BULK_BYTES  # noqa: PLC0415

        kind = message_class(surveyed.type_name)
        # Latched topics (/map, /tf_static) stay latched: late joiners on the far side would miss them otherwise.
        is_latched = all(writer.is_latched for writer in surveyed.writers.values())
        depth = self._settings.depths.get(topic)
        publisher = AdaptivePublisher(
            self._participants.of(topic, is_large=expected_bytes(kind) >= BULK_BYTES),
            kind,
            self._settings.prefix + topic,
            QoSProfile(
                depth=depth or DEFAULT_RELAY_DEPTH,
                durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if is_latched else QoSDurabilityPolicy.VOLATILE,
            ),
            overflow=self._settings.overflow.get(topic, Overflow.LATEST),
        )

        def deliver(_writer: WriterOffer, sample: Sample) -> None:
            publisher.pass_on(sample.data)

        readers = TopicReaders(
            self._participants.of(topic, is_large=False),
            self._inputs[topic],
            kind,
            survey=self._survey,
            thread=self._thread,
            deliver=deliver,
            depth=depth,
            keeps_history=is_latched,
        )
        return _Carried(type_name=surveyed.type_name, publisher=publisher, readers=readers)


def default_node_name(host: str, *, is_far: bool = False) -> str:
    """Return a node name with this host's name: two relays of one name would receive each other's parameters."""
    return f"arpd_relay_{'far_' if is_far else ''}" + re.sub(r"[^A-Za-z0-9_]", "_", host)


def run_relay(*, config_path: Path, node_name: str | None, log_level: str, is_far: bool = False) -> int:
    """Run the relay until SIGINT or SIGTERM: one end with the prefix, or one of two ends.

    Parameters
    ----------
    config_path : YAML configuration
    node_name : name of the ROS node; `default_node_name` of this host when None
    is_far : whether this is the CEDDP's end

    Raises
    ------
    LinkError
        If only a new process can use the link's address.
    """
    configure_logging(log_level, name="arpd-relay-far" if is_far else "arpd-relay")
    settings = load_settings(config_path, interfaces=None, local_domain=local_domain())
    stopping = threading.Event()
    stop_on_signals(stopping)
    notifier = Notifier()
    link = AUTO if is_far else settings.link.interface  # the file names the robot's
    addresses = Addresses(lambda: link if link != AUTO else likeliest_interface() or "")
    if settings.relay.link_domain is not None:
        from arpd.adapters.ros.ends.run import run_end  # noqa: PLC0415 - it imports ROS

        run_end(
            settings.relay,
            is_far=is_far,
            node_name=node_name or default_node_name(platform.node(), is_far=is_far),
            host=platform.node(),
            notifier=notifier,
            stopping=stopping,
            addresses=addresses,
        )
    elif is_far:
        _idle(f"nothing to do: relay.link_domain is not set in {config_path}", notifier, stopping)
    else:
        _run_one_end(settings.relay, node_name or default_node_name(platform.node()), notifier, stopping, addresses)
    return 0


def _idle(reason: str, notifier: Notifier, stopping: threading.Event) -> None:
    """Wait for the end with a status that says why, as a relay without topics does."""
    log.info("%s", reason)
    notifier.status(reason)
    notifier.ready()
    heartbeat = Watchdog(notifier)
    while not stopping.wait(0.2):
        heartbeat.beat()
    notifier.stopping()


def _run_one_end(
    settings: RelaySettings, name: str, notifier: Notifier, stopping: threading.Event, addresses: Addresses
) -> None:
    with ros_node(name) as node:
        from arpd.adapters.ros.participants import Participants  # noqa: PLC0415 - it imports ROS

        executor = best_executor(node.context)
        executor.add_node(node)
        with (
            closing(Participants(node, settings.topics)) as participants,
            closing(
                Relay(
                    node,
                    settings,
                    participants=participants,
                    on_change=lambda status: notifier.status(status.line),
                )
            ),
        ):
            heartbeat = Watchdog(notifier, parts=participants.parts)
            notifier.ready()
            serve_until(executor, stopping, heartbeat=heartbeat, addresses=addresses)
            notifier.stopping()
