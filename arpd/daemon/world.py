"""The world that a daemon observes and acts on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Collection

    from arpd.model.observation import Observation
    from arpd.model.plan import QosPlan
    from arpd.model.price import Price
    from arpd.model.probing import ProbeRequest


class World(Protocol):
    """The world of the daemon: ROS (`arpd.ros.world`), or a simulated link."""

    def observe(self, now_s: float) -> Observation:
        """Return everything one tick sees."""

    def set_price(self, price: Price) -> None:
        """Send the price of the link to every publisher."""

    def apply(self, plan: QosPlan, *, lease_s: float, missing: Collection[str], now_s: float) -> None:
        """Send the plan to the nodes if some do not show it; called twice a second.

        Parameters
        ----------
        lease_s : silence after which nodes return to their own QoS, 0 = never (s)
        missing : nodes that do not show it
        """

    def stand_by(self) -> None:
        """Take back the plan that was sent, because another daemon drives the robot; called twice a second."""

    def probe(self, request: ProbeRequest) -> None:
        """Put one probe train on the link."""
