"""The DDS participants of a relay with one end: one per hundred topics, and one for each topic of large samples."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

from rclpy.context import Context

from arpd.endpoint.node_publishers import NodePublishers
from arpd.ros.runtime import ros_node

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    #: For each thread that must not hang, returns the end of its last round (monotonic s).
    Parts: TypeAlias = Sequence[Callable[[], float]]
    #: Calls a step again and again, so often (s), until the process shall end; these parts must not hang.
    Serve: TypeAlias = Callable[[Callable[[], None], float, Parts], None]

_MOST_TOPICS = 100
_MOST_LARGE = 8  # each costs threads, and discovery with every other participant


class Participants:
    """Nodes of one process, NAME, NAME_2 and so on, each with a participant of its own, made when a topic needs it.

    Whenever a participant gets or loses an endpoint, rmw_fastrtps sends the list of all its endpoints to every other
    participant. So the cost of a plan for a participant grows with the square of its topics. And writers of one
    participant wait for each other inside Fast DDS: while a picture of 0.9 MB left at 5 Mbit/s, a topic of 100 Hz in
    the same participant came 7 times a second, and in another one 100 times.

    Parameters
    ----------
    first : the process's own node

    Attributes
    ----------
    parts : its threads
    """

    def __init__(self, first: Any) -> None:
        self._name = str(first.get_name())
        self.parts: list[Callable[[], float]] = []
        self._stack = ExitStack()
        self._nodes = {(0, False): first}
        self._of: dict[tuple[str, bool], Any] = {}
        self._watch(first)

    def of(self, topic: str, *, is_large: bool) -> Any:
        """Return the node of a topic, the same at every call.

        Parameters
        ----------
        is_large : whether it has samples that others should not wait for
        """
        if (topic, is_large) not in self._of:
            number = sum(other is is_large for _, other in self._of)
            place = number % _MOST_LARGE if is_large else number // _MOST_TOPICS, is_large
            if place not in self._nodes:
                # Nobody spins it: arpd's threads serve its publishers.
                name = f"{self._name}_{len(self._nodes) + 1}"
                self._nodes[place] = self._stack.enter_context(ros_node(name, context=Context()))
                self._watch(self._nodes[place])
            self._of[topic, is_large] = self._nodes[place]
        return self._of[topic, is_large]

    def close(self) -> None:
        """Destroy all nodes but the first."""
        self._stack.close()

    def _watch(self, node: Any) -> None:
        self.parts.append(partial(getattr, NodePublishers.of(node).thread, "finished_s"))
