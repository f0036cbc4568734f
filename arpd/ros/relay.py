"""`arpd relay`: carries topics of nodes whose code is not yours through AdaptivePublishers."""

from __future__ import annotations

import importlib
import logging
import platform
import re
import threading
import time
from typing import TYPE_CHECKING, Any

from arpd.config import load_settings
from arpd.logs import configure_logging
from arpd.ros.runtime import ros_node, spin_until, stop_on_signals
from arpd.systemd import Notifier

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.settings import RelaySettings

log = logging.getLogger(__name__)

_DISCOVER_S = 0.5
_RECEIVE_DEPTH = 100  # on-host, so this only bridges the relay's own scheduling


class UnknownTypeError(Exception):
    """A message type that is not installed on this host."""


def message_class(type_name: str) -> Any:
    """Import a message class from its ROS name, ``sensor_msgs/msg/LaserScan``.

    Raises
    ------
    UnknownTypeError
        If its package is not installed or has no such message.
    """
    package, _, message = type_name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError, ValueError) as error:
        raise UnknownTypeError(f"{type_name} is not installed here ({error})") from error


class Relay:
    """Subscribes raw to each configured topic and republishes it, unchanged, under the prefix.

    Parameters
    ----------
    node : rclpy node it lives in
    settings : topics and prefix
    on_change : told in words what is relayed, at the start and whenever it changes
    """

    def __init__(self, node: Any, settings: RelaySettings, *, on_change: Callable[[str], None]) -> None:
        self._node = node
        self._settings = settings
        self._on_change = on_change
        self._waiting = list(settings.topics)
        self._refused: list[str] = []
        on_change(self.status_line())
        node.create_timer(_DISCOVER_S, self._discover)

    def status_line(self) -> str:
        """One line a human can read, for ``systemctl status``."""
        topics = len(self._settings.topics)
        line = f"relaying {topics - len(self._waiting) - len(self._refused)} of {topics} topics"
        if self._waiting:
            line += f"; nobody publishes {', '.join(self._waiting)} yet"
        return f"{line}; no type for {', '.join(self._refused)}" if self._refused else line

    def _discover(self) -> None:
        for topic in tuple(self._waiting):
            writers = self._node.get_publishers_info_by_topic(topic)
            if not writers:
                continue
            try:
                self._carry(topic, writers)
            except UnknownTypeError as error:
                log.error("cannot relay %s: %s; the other topics go on", topic, error)  # noqa: TRY400 - no traceback
                self._refused.append(topic)
            self._waiting.remove(topic)
            self._on_change(self.status_line())

    def _carry(self, topic: str, writers: list[Any]) -> None:
        from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy  # noqa: PLC0415 - ROS is checked in ros_node

        from arpd.ros.publisher import AdaptivePublisher  # noqa: PLC0415
        from arpd.settings import DEFAULT_RELAY_DEPTH, Overflow  # noqa: PLC0415

        kind = message_class(writers[0].topic_type)
        # A reliable reader does not match a best-effort writer, so the weakest writer decides.
        all_reliable = all(w.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE for w in writers)
        reliability = QoSReliabilityPolicy.RELIABLE if all_reliable else QoSReliabilityPolicy.BEST_EFFORT
        # Latched topics (/map, /tf_static) stay latched, or late joiners on the far side would never see them.
        all_latched = all(w.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for w in writers)
        durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if all_latched else QoSDurabilityPolicy.VOLATILE
        publisher = AdaptivePublisher(
            self._node,
            kind,
            self._settings.prefix + topic,
            QoSProfile(depth=self._settings.depths.get(topic, DEFAULT_RELAY_DEPTH), durability=durability),
            overflow=self._settings.overflow.get(topic, Overflow.LATEST),
        )
        self._node.create_subscription(
            kind,
            topic,
            publisher.offer,
            QoSProfile(depth=_RECEIVE_DEPTH, reliability=reliability, durability=durability),
            raw=True,
        )
        log.info("relaying %s to %s (%s)", topic, publisher.topic_name, writers[0].topic_type)


def best_executor(context: Any = None) -> Any:
    """Return the executor with the lowest cost per message that works here.

    EventsExecutor costs a sixth of SingleThreadedExecutor's CPU per message, but it is experimental: it must deliver
    a message to itself before it is trusted.
    """
    import rclpy  # noqa: PLC0415 - ROS is checked in ros_node
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

    try:
        from rclpy.experimental import EventsExecutor  # noqa: PLC0415
    except ImportError:
        return SingleThreadedExecutor(context=context)
    from std_msgs.msg import Empty  # noqa: PLC0415

    executor = EventsExecutor(context=context)
    node = rclpy.create_node("arpd_executor_check", context=context)
    arrived = threading.Event()
    try:
        node.create_subscription(Empty, "~/check", lambda _sample: arrived.set(), 1, raw=True)
        publisher = node.create_publisher(Empty, "~/check", 1)
        executor.add_node(node)
        until_s = time.monotonic() + 2.0
        while not arrived.is_set() and time.monotonic() < until_s:
            publisher.publish(Empty())
            executor.spin_once(timeout_sec=0.05)
    finally:
        executor.remove_node(node)
        node.destroy_node()
    if arrived.is_set():
        return executor
    log.warning("EventsExecutor delivered nothing in its self-check; using SingleThreadedExecutor")
    executor.shutdown()
    return SingleThreadedExecutor(context=context)


def default_node_name(host: str) -> str:
    """Return a node name of this host's own: two relays of one name would receive each other's parameters."""
    return "arpd_relay_" + re.sub(r"[^A-Za-z0-9_]", "_", host)


def run_relay(*, config_path: Path, node_name: str | None, log_level: str) -> int:
    """Run the relay until SIGINT or SIGTERM.

    Parameters
    ----------
    config_path : YAML configuration
    node_name : name of the ROS node; `default_node_name` of this host when None
    """
    configure_logging(log_level)
    settings = load_settings(config_path, interfaces=None)
    stopping = threading.Event()
    stop_on_signals(stopping)
    notifier = Notifier()
    with ros_node(node_name or default_node_name(platform.node())) as node:
        executor = best_executor()
        executor.add_node(node)
        Relay(node, settings.relay, on_change=notifier.status)
        notifier.ready()
        spin_until(executor, stopping)
        notifier.stopping()
    return 0
