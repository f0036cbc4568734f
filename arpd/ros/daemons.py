"""How daemons of one ROS domain hear of each other, so that only one of them drives the robot."""

from __future__ import annotations

import logging
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

from arpd.incumbent import Claim, Incumbency
from arpd.ros.names import DAEMONS_TOPIC

if TYPE_CHECKING:
    from collections.abc import Callable

log = logging.getLogger(__name__)

_CLAIM_S = 0.5
_TOKEN = re.compile(r"[0-9a-f]{32}")
_MOST_NS = 2**63 - 1
_MAX_HOST = 255


class Daemons:
    """Claims that this daemon is there, and hears the others' claims.

    Parameters
    ----------
    node : rclpy node; somebody else spins it
    clock, wall_clock_ns : monotonic (s) and Unix time (ns)
    """

    def __init__(
        self,
        node: Any,
        *,
        clock: Callable[[], float] = time.monotonic,
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        own = Claim(started_ns=wall_clock_ns(), token=uuid.uuid4().hex, host=platform.node())
        self._message = DiagnosticArray(status=[to_status(own)])
        self._clock = clock
        self._incumbency = Incumbency(own)
        self._lock = threading.Lock()
        qos = QoSProfile(depth=10)
        self._publisher = node.create_publisher(DiagnosticArray, DAEMONS_TOPIC, qos)
        group = ReentrantCallbackGroup()
        node.create_subscription(DiagnosticArray, DAEMONS_TOPIC, self._on_claims, qos, callback_group=group)
        # Steady time: a simulation that stands still must not make two daemons of one.
        node.create_timer(_CLAIM_S, self._claim, callback_group=group, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def others(self) -> tuple[str, ...]:
        """Name the hosts of the other daemons that are there."""
        with self._lock:
            return tuple(claim.host for claim in self._incumbency.others(self._clock()))

    def superior(self) -> str:
        """Name the host of the daemon in charge; empty when that is this one."""
        with self._lock:
            superior = self._incumbency.superior(self._clock())
        return "" if superior is None else superior.host

    def _claim(self) -> None:
        self._publisher.publish(self._message)

    def _on_claims(self, message: Any) -> None:
        now_s = self._clock()
        for status in message.status[:1]:
            try:
                claim = from_status(status)
            except ValueError as fault:
                log.debug("ignored a claim: %s", fault)
                continue
            with self._lock:
                self._incumbency.note(claim, now_s)


def to_status(claim: Claim) -> Any:
    """Encode a claim."""
    values = [KeyValue(key="started_ns", value=str(claim.started_ns))]
    return DiagnosticStatus(name=f"arpd on {claim.host}", message="runs", hardware_id=claim.token, values=values)


def from_status(status: Any) -> Claim:
    """Decode a claim.

    Raises
    ------
    ValueError
        If it is none; the message says what is wrong.
    """
    values = {pair.key: pair.value for pair in status.values}
    host = status.name.removeprefix("arpd on ")
    if not _TOKEN.fullmatch(status.hardware_id):
        raise ValueError(f"claim with the token {status.hardware_id[:40]!r}; 32 hexadecimal digits are needed")
    if not 0 < len(host) <= _MAX_HOST or not host.isprintable():
        raise ValueError(f"claim with the host {host[:40]!r}")
    started_ns = int(values.get("started_ns", ""))
    if not 0 <= started_ns <= _MOST_NS:
        raise ValueError(f"claim with started_ns = {started_ns}; an integer from 0 to 2^63-1 is needed")
    return Claim(started_ns=started_ns, token=status.hardware_id, host=host)
