"""The DDS participants of a relay with one end: one per shard, and one for each topic of large samples."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.context import Context

from arpd.adapters.ros.node_publishers import NodePublishers
from arpd.adapters.ros.runtime import ros_node
from arpd.apply.relay_status import shard_name, shards

if TYPE_CHECKING:
    from collections.abc import Callable

_MOST_FOR_LARGE = 8  # each costs threads, and discovery with every other participant


class Participants:
    """Nodes of one process, each with a participant of its own, and the topics of each.

    Writers of one participant wait for each other inside Fast DDS: while a picture of 0.9 MB left at 5 Mbit/s, a topic
    of 100 Hz in the same participant came 7 times a second, and in another one 100 times.

    Parameters
    ----------
    first : the process's own node
    topics : that the relay may carry

    Attributes
    ----------
    names : fully qualified names of all nodes
    parts : for each thread that must not hang, returns the end of its last round (monotonic s)
    """

    def __init__(self, first: Any, topics: tuple[str, ...]) -> None:
        self._name = str(first.get_name())
        self.names: set[str] = set()
        self.parts: list[Callable[[], float]] = []
        self._stack = ExitStack()
        self._count = 0
        self._take(first)
        self._of: dict[str, Any] = {}
        for number, shard in enumerate(shards(topics)):
            self._of.update(dict.fromkeys(shard, first if number == 0 else self._make()))
        self._large: list[Any] = []
        self._of_large: dict[str, Any] = {}

    def of(self, topic: str, *, is_large: bool) -> Any:
        """Return the node of a topic, the same at every call.

        Parameters
        ----------
        is_large : whether it has samples that others should not wait for
        """
        if not is_large:
            return self._of[topic]
        if topic not in self._of_large:
            if len(self._large) < _MOST_FOR_LARGE:
                self._large.append(self._make())
            self._of_large[topic] = self._large[len(self._of_large) % len(self._large)]
        return self._of_large[topic]

    def close(self) -> None:
        """Destroy all nodes but the first."""
        self._stack.close()

    def _make(self) -> Any:
        """Return a new node in a participant of its own, which nobody spins: arpd's threads serve its publishers."""
        name = shard_name(self._name, self._count)
        node = self._stack.enter_context(ros_node(name, context=Context(), has_services=False))
        self._take(node)
        return node

    def _take(self, node: Any) -> None:
        self._count += 1
        self.names.add(node.get_fully_qualified_name())
        self.parts.append(partial(getattr, NodePublishers.of(node).thread, "finished_s"))
