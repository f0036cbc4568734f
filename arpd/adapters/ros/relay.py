"""`arpd relay`: republishes topics of nodes whose code is not yours through AdaptivePublishers."""

from __future__ import annotations

import logging
import platform
import re
import threading
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.adapters.config.domain import local_domain
from arpd.adapters.config.load import load_settings
from arpd.adapters.host.addresses import Addresses
from arpd.adapters.host.interface import likeliest_interface
from arpd.adapters.ros.ends.types import UnknownTypeError, expected_bytes, message_class
from arpd.adapters.ros.graph import NOT_NAMED_YET, node_name_of, policies_of
from arpd.adapters.ros.runtime import best_executor, ros_node, serve_until, stop_on_signals
from arpd.adapters.systemd.journal import configure_logging
from arpd.adapters.systemd.notify import Notifier, Watchdog
from arpd.apply.relay.depths import BULK_BYTES, held_depth
from arpd.apply.relay_routes import Route, RouteRefusal, TopicWriter, choose_route, own_output
from arpd.apply.relay_status import RelayStatus, shards
from arpd.model.settings import AUTO

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.adapters.ros.participants import Participants
    from arpd.adapters.ros.publisher import AdaptivePublisher
    from arpd.adapters.ros.reader import ReaderQos
    from arpd.adapters.ros.subscription import AdaptiveSubscription
    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)

_DISCOVER_S = 0.5
_EVERY_LOOK = 60  # every 60th look at a topic reads its endpoints, even when their numbers are unchanged
_KEEP_LOOKS = 20  # 10 s: enough for a source to restart, and an end for a loop whose source never comes


class Relay:
    """Subscribes raw to each configured topic and republishes it, unchanged, under the prefix.

    It looks at the graph again and again. A topic is carried once it has a publisher; its reader follows the weakest
    writer; a topic that returns with another type is carried with that type. A topic that cannot be carried is named,
    and the others go on. Most looks at a settled topic only count its endpoints.

    Parameters
    ----------
    node : rclpy node it lives in
    settings : topics and prefix
    on_change : called with the status at the start and whenever it changes
    participants : all nodes of the relay; None = this one only
    """

    def __init__(
        self,
        node: Any,
        settings: RelaySettings,
        *,
        on_change: Callable[[RelayStatus], None],
        participants: Participants | None = None,
    ) -> None:
        from rclpy.clock import Clock, ClockType  # noqa: PLC0415 - ROS is checked in ros_node

        self._node = node
        self._settings = settings
        self._on_change = on_change
        self._participants = participants
        self._carried: dict[str, _Carried] = {}
        self._refused: dict[str, str] = {}
        self._failed: dict[str, str] = {}  # topic → type that could not be carried
        self._looks = 0
        self._silent = dict.fromkeys(settings.topics, 0)  # topic → looks since it had a publisher
        self._once: set[str] = set()  # topics that were carried before
        self._inputs = {topic: node.resolve_topic_name(topic) for topic in settings.topics}  # counting does not remap
        self._outputs: dict[str, str] = {}  # topic → name it is republished under
        for topic in settings.topics:
            output = str(node.resolve_topic_name(settings.prefix + topic))
            if refusal := own_output(topic, prefix=settings.prefix, output=output):
                self._refuse(topic, refusal.reason)
            else:
                self._outputs[topic] = output
        self._status = self.status()
        on_change(self._status)
        # Steady time, so that a paused simulation does not stop the relay from following the graph.
        node.create_timer(_DISCOVER_S, self._discover, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def status(self) -> RelayStatus:
        """Return what is carried, and what is not and why."""
        silent = [topic for topic in self._settings.topics if topic in self._silent and topic not in self._refused]
        return RelayStatus(
            topics=self._settings.topics,
            flowing=tuple(topic for topic in self._carried if topic not in self._silent),
            unpublished=tuple(topic for topic in silent if topic not in self._once),
            gone=tuple(topic for topic in silent if topic in self._once),
            refused=tuple(self._refused.items()),
            ignored=tuple((topic, each.route.ignored) for topic, each in self._carried.items() if each.route.ignored),
        )

    def _discover(self) -> None:
        self._looks += 1
        for number, (topic, output) in enumerate(self._outputs.items()):
            # Reading all endpoints of 100 topics twice a second would cost as much as relaying 100 messages.
            turn = self._looks + number
            carried = self._carried.get(topic)
            is_left_out = turn % 2 and carried is not None and carried.settled_with is not None
            if turn % _EVERY_LOOK == 0 or not (is_left_out or self._is_settled(topic)):
                self._look(topic, output)
        if (status := self.status()) != self._status:
            self._status = status
            self._on_change(status)

    def _is_settled(self, topic: str) -> bool:
        """Return whether the topic is carried as chosen, and has as many endpoints as when they were last read."""
        carried = self._carried.get(topic)
        return (
            carried is not None
            and topic not in self._silent
            and topic not in self._refused
            and carried.settled_with == self._endpoints(topic, carried)
        )

    def _endpoints(self, topic: str, carried: _Carried | None) -> tuple[int, int, int]:
        """Count the topic's writers, those that the relay hears, and the readers of its output.

        A writer that the reader in force would not hear shows at once, also where it has replaced another.
        """
        with self._node.handle:  # Node.count_publishers would check the name again
            sources = self._node.handle.get_count_publishers(self._inputs[topic])
        if carried is None:
            return sources, 0, 0
        return sources, carried.subscription.get_publisher_count(), carried.publisher.get_subscription_count()

    def _look(self, topic: str, output: str) -> None:
        carried = self._carried.get(topic)
        endpoints = self._endpoints(topic, carried)  # first: endpoints that come later change the next count
        sources = [_source(info) for info in self._node.get_publishers_info_by_topic(topic)]
        readers = {node_name_of(info) for info in self._node.get_subscriptions_info_by_topic(output)}
        unknown = {name for name in (*readers, *(source.node for source in sources)) if NOT_NAMED_YET in name}
        route = choose_route(
            sources,
            carriers=self._participants.names if self._participants else {self._node.get_fully_qualified_name()},
            output=output,
            output_readers=readers - unknown,
            in_force=None if carried is None else carried.route,
        )
        if route is None:
            self._rest(topic)
            return
        self._silent.pop(topic, None)
        if isinstance(route, RouteRefusal):
            self._drop(topic)
            self._refuse(topic, route.reason)
        elif self._failed.get(topic) != route.type_name:
            self._follow(topic, route)
        if (carried := self._carried.get(topic)) is not None:
            carried.settled_with = endpoints if carried.is_followed and not unknown else None

    def _rest(self, topic: str) -> None:
        """Keep a topic without a publisher for a while, in case its source returns, then drop it."""
        self._silent[topic] = self._silent.get(topic, 0) + 1
        if (carried := self._carried.get(topic)) is not None:
            carried.settled_with = None
        self._refused.pop(topic, None)
        self._failed.pop(topic, None)
        if self._silent[topic] > _KEEP_LOOKS:
            self._drop(topic)

    def _follow(self, topic: str, route: Route) -> None:
        """Carry the topic by this route, regardless of its previous one."""
        carried = self._carried.get(topic)
        if carried is not None and carried.route.type_name != route.type_name:
            log.info("%s returned as %s; it was %s", topic, route.type_name, carried.route.type_name)
            self._drop(topic)
            # The next look carries it. With a new writer at once, a far reader never matched in 4 of 27 runs.
            return
        try:
            if carried is None:
                carried = self._carried[topic] = self._carry(topic, route)
                self._once.add(topic)
                log.info("relaying %s to %s (%s)", topic, carried.publisher.topic_name, route.type_name)
            else:
                carried.follow(route)
        except UnknownTypeError as error:
            self._failed[topic] = route.type_name  # not imported again before the type changes
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

    def _carry(self, topic: str, route: Route) -> _Carried:
        from rclpy.qos import QoSProfile  # noqa: PLC0415 - ROS is checked in ros_node

        from arpd.adapters.ros.publisher import AdaptivePublisher  # noqa: PLC0415
        from arpd.adapters.ros.subscription import AdaptiveSubscription  # noqa: PLC0415
        from arpd.model.settings import DEFAULT_RELAY_DEPTH, Overflow  # noqa: PLC0415

        kind = message_class(route.type_name)
        policies = policies_of(is_reliable=route.is_reliable, is_latched=route.is_latched)
        is_large = expected_bytes(kind) >= BULK_BYTES
        publisher = AdaptivePublisher(
            self._participants.for_large(topic) if is_large and self._participants else self._node,
            kind,
            self._settings.prefix + topic,
            QoSProfile(depth=self._settings.depths.get(topic, DEFAULT_RELAY_DEPTH), durability=policies["durability"]),
            overflow=self._settings.overflow.get(topic, Overflow.LATEST),
        )
        depth = held_depth(publisher.baseline.depth, sample_bytes=expected_bytes(kind))
        try:
            subscription = AdaptiveSubscription(
                self._node,
                kind,
                topic,
                publisher.pass_on,
                QoSProfile(depth=depth, **policies),
                raw=True,
            )
        except Exception:
            publisher.destroy()  # without its reader it would announce a topic that never has samples
            raise
        return _Carried(route=route, publisher=publisher, subscription=subscription)


@dataclass(slots=True)
class _Carried:
    """A topic that is relayed: its subscription and its publisher."""

    route: Route
    publisher: AdaptivePublisher
    subscription: AdaptiveSubscription
    settled_with: tuple[int, int, int] | None = None  # number of endpoints when nothing was left to do

    @property
    def is_followed(self) -> bool:
        """True when the reader has the QoS of the route, and no writer is ignored."""
        return self._wanted(self.route) == self.subscription.qos and not self.route.ignored

    def follow(self, route: Route) -> None:
        """Let the reader follow the weakest writer, without losing or doubling a sample."""
        # Compared with the QoS in force, not with the requested one, so that a failed swap is tried again.
        qos = self._wanted(route)
        if qos != self.subscription.qos:
            self.subscription.renew(qos)
        self.route = route

    def _wanted(self, route: Route) -> ReaderQos:
        policies = policies_of(is_reliable=route.is_reliable, is_latched=route.is_latched)
        return replace(self.subscription.qos, **policies)

    def destroy(self) -> None:
        self.subscription.destroy()
        self.publisher.destroy()


def _source(info: Any) -> TopicWriter:
    from rclpy.qos import QoSDurabilityPolicy, QoSReliabilityPolicy  # noqa: PLC0415 - ROS is checked in ros_node

    return TopicWriter(
        node=node_name_of(info),
        type_name=info.topic_type,
        is_reliable=info.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE,
        is_latched=info.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL,
    )


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
    parts = [replace(settings, topics=topics) for topics in shards(settings.topics)]
    statuses = [RelayStatus()] * len(parts)

    telling = threading.Lock()  # each shard has a thread, and the last line must be the newest

    def note(number: int, status: RelayStatus) -> None:
        with telling:
            statuses[number] = status
            notifier.status(RelayStatus.of(statuses).line)

    with ros_node(name) as node:
        from arpd.adapters.ros.participants import Participants  # noqa: PLC0415 - it imports ROS

        executor = best_executor(node.context)
        executor.add_node(node)
        with closing(Participants(node, name)) as participants:
            nodes = [node, *(participants.make() for _ in parts[1:])]
            for number, (each, part) in enumerate(zip(nodes, parts, strict=True)):
                Relay(each, part, on_change=partial(note, number), participants=participants)
            heartbeat = Watchdog(notifier, parts=participants.parts)
            notifier.ready()
            serve_until(executor, stopping, heartbeat=heartbeat, addresses=addresses)
            notifier.stopping()
