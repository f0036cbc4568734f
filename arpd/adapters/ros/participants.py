"""The DDS participants of a relay with one end: one per shard, and one for each topic of large samples."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.node_publishers import NodePublishers
from arpd.adapters.ros.runtime import ros_node, spinning_alone
from arpd.apply.relay_status import shard_name

if TYPE_CHECKING:
    from collections.abc import Callable

_MOST_FOR_LARGE = 8  # each costs threads, and discovery with every other participant


class Participants:
    """Nodes of one process, each with a participant of its own.

    Writers of one participant wait for each other inside Fast DDS: while a picture of 0.9 MB left at 5 Mbit/s, a topic
    of 100 Hz in the same participant came 7 times a second, and in another one 100 times.

    Parameters
    ----------
    first : the process's own node
    name : its name

    Attributes
    ----------
    names : fully qualified names of all nodes
    parts : for each thread that must not hang, returns the end of its last round (monotonic s)
    """

    def __init__(self, first: Any, name: str) -> None:
        self._name = name
        self.names: set[str] = set()
        self.parts: list[Callable[[], float]] = []
        self._stack = ExitStack()
        self._count = 0
        self._large: list[Any] = []
        self._of_topic: dict[str, Any] = {}
        self._lock = threading.Lock()  # each shard has a thread
        self._take(first)

    def make(self) -> Any:
        """Return a new node in a participant of its own, which a thread of its own spins."""
        from rclpy import Context  # noqa: PLC0415 - ROS is checked in ros_node

        with self._lock:
            return self._make(Context())

    def for_large(self, topic: str) -> Any:
        """Return the node that publishes a topic of large samples, the same at every call."""
        from rclpy import Context  # noqa: PLC0415 - ROS is checked in ros_node

        with self._lock:
            if topic not in self._of_topic:
                if len(self._large) < _MOST_FOR_LARGE:
                    self._large.append(self._make(Context()))
                self._of_topic[topic] = self._large[len(self._of_topic) % len(self._large)]
            return self._of_topic[topic]

    def close(self) -> None:
        """Destroy all nodes but the first."""
        self._stack.close()

    def _make(self, context: Any) -> Any:
        node = self._stack.enter_context(ros_node(shard_name(self._name, self._count), context=context))
        self._take(node)
        self.parts.append(self._stack.enter_context(spinning_alone(node)))
        return node

    def _take(self, node: Any) -> None:
        self._count += 1
        self.names.add(node.get_fully_qualified_name())
        self.parts.append(partial(getattr, NodePublishers.of(node).thread, "finished_s"))
