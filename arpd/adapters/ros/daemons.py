"""How daemons of one ROS domain hear of each other, so that only one of them drives the robot."""

from __future__ import annotations

import platform
import re
import threading
import time
import uuid
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from arpd.adapters.ros.events import no_publisher_events
from arpd.adapters.ros.names import DAEMONS_TOPIC, GATE_TOPIC
from arpd.adapters.ros.raw_subscription import RawSubscription, RefusedMessages, peek
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.observe.leader import LEAST_STARTED_NS, DaemonHeartbeat, Leader
from arpd.observe.rate_limits import TokenBucket

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.ros.raw_subscription import Pause

_CLAIM_S = 0.5
_TOKEN = re.compile(r"[0-9a-f]{32}")
_MOST_NS = 2**63 - 1
_MAX_HOST = 255
_MOST_BYTES = 2048  # of a message: one claim
_HZ, _BURST = 50.0, 50.0  # of all daemons; each claims twice a second
_HEAD = "arpd on "


class Daemons:
    """Claims that this daemon is there, and hears the others' claims.

    No more daemons are believed than the graph shows nodes that could be some: they write claims, and the gate.

    Parameters
    ----------
    node : rclpy node; somebody else spins it
    refused : counts what is
    pause : of the executor, in a flood
    clock, wall_clock_ns : monotonic (s) and Unix time (ns)
    """

    def __init__(
        self,
        node: Any,
        *,
        refused: RefusedMessages | None = None,
        pause: Pause | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        # A clock that was never set reads less than others believe.
        started_ns = max(LEAST_STARTED_NS, wall_clock_ns())
        own = DaemonHeartbeat(started_ns=started_ns, token=uuid.uuid4().hex, host=platform.node())
        self._node = node
        self._message = DiagnosticArray(status=[to_status(own)])
        self._refused = RefusedMessages() if refused is None else refused
        self._clock = clock
        self._leader = Leader(own)
        self._bucket = TokenBucket(_HZ, _BURST)
        self._rivals = 0
        self._lock = threading.Lock()
        qos = QoSProfile(depth=100)
        self._publisher = node.create_publisher(
            DiagnosticArray, DAEMONS_TOPIC, QoSProfile(depth=10), event_callbacks=no_publisher_events()
        )
        self._subscription = RawSubscription(
            node,
            DiagnosticArray,
            DAEMONS_TOPIC,
            qos,
            most_bytes=_MOST_BYTES,
            take=self._on_claim,
            refuse=lambda: self._refuse(MessageRefusal.SIZE, "a message is longer than any claim"),
            pause=pause,
        )
        group = ReentrantCallbackGroup()
        # Steady time: a simulation that stands still must not make two daemons of one.
        node.create_timer(_CLAIM_S, self._claim, callback_group=group, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def others(self) -> tuple[str, ...]:
        """Name the hosts of the other daemons that are there."""
        with self._lock:
            return tuple(claim.host for claim in self._leader.others(self._clock(), most=self._rivals))

    def active_daemon(self) -> str:
        """Name the host of the daemon in charge; empty when that is this one."""
        with self._lock:
            active_daemon = self._leader.active_daemon(self._clock(), most=self._rivals)
        return "" if active_daemon is None else active_daemon.host

    def _claim(self) -> None:
        self._publisher.publish(self._message)
        daemons = min(self._node.count_publishers(DAEMONS_TOPIC), self._node.count_publishers(GATE_TOPIC))
        with self._lock:
            self._rivals = daemons - 1

    def _on_claim(self, data: bytes, _info: Any) -> None:
        now_s = self._clock()
        if not self._bucket.take(now_s):
            self._refuse(MessageRefusal.RATE, "there are more claims than all daemons together make")
            return
        try:
            peek(data)  # it has a status, or this raises
            claim = from_status(deserialize_message(data, DiagnosticArray).status[0])
        except (RuntimeError, ValueError) as fault:  # the first is what rclpy makes of bytes it cannot decode
            self._refuse(MessageRefusal.MALFORMED, str(fault))
            return
        with self._lock:
            has_place = self._leader.note(claim, now_s)
        if not has_place:
            self._refuse(MessageRefusal.QUOTA, "more daemons claim to be there than any robot has")

    def _refuse(self, reason: MessageRefusal, words: str) -> None:
        self._refused.note(MessageKind.HEARTBEATS, reason, words)


def to_status(claim: DaemonHeartbeat) -> Any:
    """Encode a claim."""
    values = [KeyValue(key="started_ns", value=str(claim.started_ns))]
    return DiagnosticStatus(name=f"{_HEAD}{claim.host}", message="runs", hardware_id=claim.token, values=values)


def from_status(status: Any) -> DaemonHeartbeat:
    """Decode a claim.

    Raises
    ------
    ValueError
        If it is none; the message says what is wrong.
    """
    values = {pair.key: pair.value for pair in status.values}
    host = status.name.removeprefix(_HEAD)
    if not _TOKEN.fullmatch(status.hardware_id):
        raise ValueError(f"claim with the token {status.hardware_id[:40]!r}; 32 hexadecimal digits are needed")
    if not 0 < len(host) <= _MAX_HOST or not host.isprintable():
        raise ValueError(f"claim with the host {host[:40]!r}")
    started_ns = int(values.get("started_ns", "")[:40])
    if not LEAST_STARTED_NS <= started_ns <= _MOST_NS:
        raise ValueError(f"claim with started_ns = {started_ns}; a time from 2020 on is needed, below 2^63")
    return DaemonHeartbeat(started_ns=started_ns, token=status.hardware_id, host=host)
