"""Heartbeats between the daemons of one ROS domain, so that only one of them drives the robot."""

from __future__ import annotations

import math
import platform
import re
import threading
import time
import uuid
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from arpd.adapters.ros.names import DAEMONS_TOPIC, PRICE_TOPIC
from arpd.adapters.ros.raw_reader import RawReader
from arpd.adapters.ros.refused_messages import RefusedMessages
from arpd.adapters.ros.serialized import peek
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.leader import LEAST_STARTED_NS, DaemonHeartbeat, Leader
from arpd.observe.rate_limits import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.ros.raw_reader import ReadingThread, Sample

_HEARTBEAT_S = 0.5
_TOKEN = re.compile(r"[0-9a-f]{32}")
_MOST_NS = 2**63 - 1
_MAX_HOST = 255
_MOST_BYTES = 2048  # of a message: one heartbeat
_HZ, _BURST = 50.0, 50.0  # of all daemons; each sends two a second
_HEAD = "arpd on "


class Daemons:
    """Sends this daemon's heartbeats while somebody calls `step`, and receives the others'.

    At most as many daemons are believed as the graph shows nodes that write heartbeats and a price.

    Parameters
    ----------
    node : rclpy node
    thread : reads the others'
    refused : counts refused messages
    clock, wall_clock_ns : monotonic (s) and Unix time (ns)
    """

    def __init__(
        self,
        node: Any,
        *,
        thread: ReadingThread,
        refused: RefusedMessages | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        # A clock that was never set reads less than the others accept.
        started_ns = max(LEAST_STARTED_NS, wall_clock_ns())
        own = DaemonHeartbeat(started_ns=started_ns, token=uuid.uuid4().hex, host=platform.node())
        self._node = node
        self._message = DiagnosticArray(status=[to_status(own)])
        self._refused = RefusedMessages() if refused is None else refused
        self._clock = clock
        self._leader = Leader(own)
        self._bucket = TokenBucket(_HZ, _BURST)
        self._most_others = 0  # that the graph allows
        self._lock = threading.Lock()
        self._beat_s = -math.inf
        self._publisher = node.create_publisher(DiagnosticArray, DAEMONS_TOPIC, QoSProfile(depth=10))
        self._reader = RawReader(
            node,
            DiagnosticArray,
            DAEMONS_TOPIC,
            QoSProfile(depth=100),
            deliver=self._on_heartbeat,
            thread=thread,
            most_bytes=_MOST_BYTES,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "a message is longer than any heartbeat"),
        )

    def others(self) -> tuple[str, ...]:
        """Return the hosts of the other live daemons."""
        with self._lock:
            return tuple(other.host for other in self._leader.others(self._clock(), most=self._most_others))

    def active_daemon(self) -> str:
        """Return the host of the active daemon; empty when this one is active."""
        with self._lock:
            active_daemon = self._leader.active_daemon(self._clock(), most=self._most_others)
        return "" if active_daemon is None else active_daemon.host

    def step(self, now_s: float) -> None:
        """Send a heartbeat if it is time; call it several times a second."""
        if now_s - self._beat_s < _HEARTBEAT_S:
            return
        self._beat_s = now_s
        self._publisher.publish(self._message)
        daemons = min(self._node.count_publishers(DAEMONS_TOPIC), self._node.count_publishers(PRICE_TOPIC))
        with self._lock:
            self._most_others = daemons - 1

    def _on_heartbeat(self, sample: Sample) -> None:
        now_s = self._clock()
        if not self._bucket.take(now_s):
            self._refuse(MessageRefusal.RATE, "there are more heartbeats than all daemons together send")
            return
        try:
            peek(sample.data)  # it has a status, or this raises
            heartbeat = from_status(deserialize_message(sample.data, DiagnosticArray).status[0])
        except (RuntimeError, ValueError) as fault:  # rclpy raises the first for bytes that it cannot decode
            self._refuse(MessageRefusal.MALFORMED, str(fault))
            return
        with self._lock:
            has_room = self._leader.note(heartbeat, now_s)
        if not has_room:
            self._refuse(MessageRefusal.QUOTA, "there are heartbeats of more daemons than any robot has")

    def _refuse(self, reason: MessageRefusal, words: str) -> None:
        self._refused.note(MessageKind.HEARTBEATS, reason, words)


def to_status(heartbeat: DaemonHeartbeat) -> Any:
    """Encode a heartbeat."""
    values = [KeyValue(key="started_ns", value=str(heartbeat.started_ns))]
    return DiagnosticStatus(name=f"{_HEAD}{heartbeat.host}", message="runs", hardware_id=heartbeat.token, values=values)


def from_status(status: Any) -> DaemonHeartbeat:
    """Decode a heartbeat.

    Raises
    ------
    ValueError
        If the status is no heartbeat; the message names the fault.
    """
    values = {pair.key: pair.value for pair in status.values}
    host = status.name.removeprefix(_HEAD)
    if not _TOKEN.fullmatch(status.hardware_id):
        raise ValueError(f"heartbeat with the token {status.hardware_id[:40]!r}; 32 hexadecimal digits are needed")
    if not 0 < len(host) <= _MAX_HOST or not host.isprintable():
        raise ValueError(f"heartbeat with the host {host[:40]!r}; 1 to {_MAX_HOST} printable characters are needed")
    started_ns = int(values.get("started_ns", "")[:40])
    if not LEAST_STARTED_NS <= started_ns <= _MOST_NS:
        raise ValueError(f"heartbeat with started_ns = {started_ns}; a time from 2020 on is needed, below 2^63")
    return DaemonHeartbeat(started_ns=started_ns, token=status.hardware_id, host=host)
