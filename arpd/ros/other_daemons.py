"""The other daemons of the ROS domain, by their prices."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy

from arpd.ros.graph import Endpoint
from arpd.ros.inbox import PRICES, Inbox

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_QOS = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_SILENT_S = 3.5  # three prices missed: that daemon is gone, or stands by
_MOST_DAEMONS = 32


class OtherDaemons:
    """Hears their prices: while a daemon with a lower GUID sends its own, this one stands by.

    A daemon that stands by sends no price, so the graph shows those.

    Parameters
    ----------
    own : GUID of the daemon's own writer of prices
    tells_hosts : whether GUIDs name the host

    Attributes
    ----------
    others : where each of them is
    """

    def __init__(
        self, node: Any, own: bytes, *, tells_hosts: bool, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._own = own
        self._tells_hosts = tells_hosts
        self._clock = clock
        self._heard_s: dict[bytes, float] = {}  # of each daemon heard lately; replaced, so any thread may read it
        self.others: tuple[str, ...] = ()
        self.inbox = Inbox(node, PRICES, _QOS, lambda sample, _price: self._hear(sample.writer), clock=clock)

    @property
    def are_heard(self) -> bool:
        """Whether another daemon has sent its price lately."""
        return bool(self._lately())

    def active_daemon(self) -> str:
        """Return where the active daemon is, empty when it is this one."""
        drives = min(self._lately(), default=self._own)
        return self._place(drives) if drives < self._own else ""

    def see(self, writers: Iterable[Endpoint]) -> None:
        """Take in the writers of prices that the graph shows."""
        found = {writer.gid for writer in writers} - {self._own}
        self.others = tuple(self._place(each) for each in sorted(found)[:_MOST_DAEMONS])

    def _hear(self, who: bytes) -> None:
        lately = self._lately()
        if who != self._own and (who in lately or len(lately) < _MOST_DAEMONS):
            self._heard_s = {**lately, who: self._clock()}

    def _lately(self) -> dict[bytes, float]:
        now_s = self._clock()
        return {who: at_s for who, at_s in self._heard_s.items() if now_s - at_s <= _SILENT_S}

    def _place(self, guid: bytes) -> str:
        if not self._tells_hosts:
            return "a host that its middleware does not tell"
        return "this host" if Endpoint(gid=guid).host == Endpoint(gid=self._own).host else "another host"
