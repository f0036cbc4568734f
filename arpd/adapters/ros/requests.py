"""What the readers of a topic request, as the graph shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.adapters.ros.graph import deadline_ns_of, node_name_of
from arpd.govern.plan import is_kept

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.node import Node


class Requests:
    """The deadlines that readers of a topic request.

    Parameters
    ----------
    node : any node; it sees the whole graph
    topic : fully qualified topic name
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic

    def tightest_ns(self) -> int:
        """Return the shortest, 0 = none is requested (ns)."""
        return min((request for _, request in self._all() if request), default=0)

    def names(self) -> list[str]:
        """Name the nodes that read the topic."""
        return sorted(name for name, _ in self._all())

    def lost(self, *, offered_ns: int, offer_ns: int) -> list[str]:
        """Name the readers that hear a writer with the one deadline and would not hear one with the other (ns)."""
        return sorted(
            f"{name} requests {request} ns"
            for name, request in self._all()
            if is_kept(offered_ns, request) and not is_kept(offer_ns, request)
        )

    def _all(self) -> Iterator[tuple[str, int]]:
        for reader in self._node.get_subscriptions_info_by_topic(self._topic):
            yield node_name_of(reader), deadline_ns_of(reader.qos_profile)
