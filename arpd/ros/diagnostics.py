"""The daemon's state on /diagnostics, for rqt_robot_monitor, aggregators and other monitors."""

from __future__ import annotations

import logging
import math
import platform
import time
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSProfile

from arpd.model.quantities import printable
from arpd.report.diagnostics import Status, diagnose
from arpd.report.wording import MOST_TEXT
from arpd.ros.rate_limits import OncePerMinute

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.report.snapshot import Snapshot

log = logging.getLogger(__name__)

DIAGNOSTICS_TOPIC = "/diagnostics"
_EVERY_S = 1.0


class Diagnostics:
    """Publishes once a second and soon after every event, while somebody subscribes and `look` is called."""

    def __init__(
        self,
        node: Any,
        snapshot: Callable[[], Snapshot | None],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._snapshot = snapshot
        self._clock = clock
        self._host = platform.node()
        # Reliable and one deep, as in diagnostic_updater: each message has everything.
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, QoSProfile(depth=1))
        self._published_s = -math.inf
        self._told = 0
        self._logged = OncePerMinute()

    def look(self) -> None:
        """Publish if it is time; call it after every tick, also one that failed."""
        try:
            self._publish_if_due()
        except Exception:
            if self._logged.take(DIAGNOSTICS_TOPIC, self._clock()):
                log.exception("nothing is published on %s; the daemon goes on", DIAGNOSTICS_TOPIC)

    def _publish_if_due(self) -> None:
        now_s, snapshot = self._clock(), self._snapshot()
        newest = snapshot.events[-1].number if snapshot is not None and snapshot.events else 0
        if now_s - self._published_s < _EVERY_S and newest == self._told:
            return
        self._published_s, self._told = now_s, newest
        if not self._publisher.get_subscription_count():
            return
        array = DiagnosticArray(status=[self._message(status) for status in diagnose(snapshot, now_s=now_s)])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def _message(self, status: Status) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=bytes([status.level]),
            name=status.name,
            message=_line(status.message),
            hardware_id=self._host,
            values=[KeyValue(key=_line(key), value=_line(text)) for key, text in status.values.items()],
        )


def _line(text: str) -> str:
    return printable(text, longest=MOST_TEXT)
