"""The ROS graph as one process sees it."""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING, Any, TypeVar

from rclpy.impl.implementation_singleton import rclpy_implementation

from arpd.ros.graph import Endpoint, readers_of, writers_of
from arpd.ros.rcl import InvalidHandle, attached, rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rclpy.node import Node

log = logging.getLogger(__name__)
ON_EVERY_NODE = "/parameter_events"  # every node of rclcpp and rclpy writes it
_RESTS = 10.0  # times as long as reading took
_MOST_REST_S = 2.0  # samples of a writer that is not known yet are held for 3

T = TypeVar("T")


class GraphView:
    """The graph, of which each part is read when somebody asks for it, and again after the graph has changed.

    The middleware tells that something has changed, but not what. So a look that finds a change forgets everything, and
    at rest a look costs 25 µs however large the graph is. To find the endpoints of one topic, the middleware goes
    through those of all topics: those of 1,000 topics take 0.1 s. After a change the next one is noticed only when ten
    times as long has passed as was spent on reading.

    There is one view for each context, because the middleware tells each change once. All of it may be used by any
    thread.

    Parameters
    ----------
    node : the first node that asks; it must live as long as the others

    Attributes
    ----------
    own : a writer of the node; its GUID names this process and this host
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.RLock()
        self._waits = rclpy_implementation.WaitSet(0, 1, 0, 0, 0, 0, node.context.handle)
        self._known: dict[tuple[str, str], Any] = {}
        self._types: Mapping[str, Sequence[str]] = {}
        self._services: Mapping[str, Sequence[str]] = {}
        self._changes = 0
        self._noticed_s = time.monotonic()
        self._spent_s = 0.0  # on reading since then
        self.own = Endpoint(gid=rcl().gid_of(next(iter(node.publishers)).handle), node=node.get_fully_qualified_name())

    @classmethod
    def of(cls, node: Node) -> GraphView:
        """Return the view of a node's context, made on first use."""
        return attached(node.context, cls, lambda: cls(node))

    def look(self) -> int:
        """Forget what was read if the graph has changed since; return how often it has."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._noticed_s >= self.rest_s and self._has_changed():
                self._known.clear()
                self._changes += 1
                self._noticed_s, self._spent_s = now_s, 0.0
            return self._changes

    @property
    def rest_s(self) -> float:
        """Time from the last change that was noticed until the next can be (s)."""
        return min(_MOST_REST_S, _RESTS * self._spent_s)

    @property
    def types(self) -> Mapping[str, Sequence[str]]:
        """The types of every topic; those before the change where the graph has a name that is no text."""
        self._types = self._once("types", "", lambda: dict(self._node.get_topic_names_and_types()), self._types)
        return self._types

    @property
    def services(self) -> Mapping[str, Sequence[str]]:
        """The types of every service, likewise."""
        read = self._node.get_service_names_and_types
        self._services = self._once("services", "", lambda: dict(read()), self._services)
        return self._services

    @property
    def participants(self) -> frozenset[bytes]:
        """First bytes of the GUIDs of every process with a node."""
        return frozenset(writer.participant for writer in self.writers(ON_EVERY_NODE))

    @property
    def ours(self) -> frozenset[bytes]:
        """Those of this process, and of all others with a node of this name.

        A killed process stays in the graph until DDS gives it up, and so do its ghosts. They belong to nobody here.
        """
        return self._once("ours", "", self._namesakes, frozenset({self.own.participant}))

    def writers(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the writers of a topic; none where the graph has a name that is no text."""
        return self._once("writers", topic, lambda: writers_of(self._node, topic), ())

    def writers_now(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the writers of a topic as they are at this moment, however long the graph may rest."""
        with self._lock:
            self._known.pop(("writers", topic), None)
            return self.writers(topic)

    def readers(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the readers of a topic, likewise."""
        return self._once("readers", topic, lambda: readers_of(self._node, topic), ())

    def servers(self, service: str) -> tuple[Endpoint, ...]:
        """Return the servers of a service, as the readers of the DDS topic of its requests."""
        topic = f"rq{service}Request"
        return self._once("servers", service, lambda: readers_of(self._node, topic, is_of_dds=True), ())

    def responders(self, service: str) -> tuple[Endpoint, ...]:
        """Return the same servers, as the writers of their responses."""
        topic = f"rr{service}Reply"
        return self._once("responders", service, lambda: writers_of(self._node, topic, is_of_dds=True), ())

    def _namesakes(self) -> frozenset[bytes]:
        found = (writer.participant for writer in self.writers(ON_EVERY_NODE) if writer.node == self.own.node)
        return frozenset({self.own.participant, *found})

    def _once(self, kind: str, name: str, read: Callable[[], T], default: T) -> T:
        """Return what was read since the last change, or read it now; the default where that fails."""
        with self._lock:
            if (kind, name) not in self._known:
                begun_s = time.monotonic()
                try:
                    self._known[kind, name] = read()
                except InvalidHandle:
                    raise
                except (RuntimeError, ValueError) as fault:
                    log.debug("%s of %s left out: %s", kind, name, fault)
                    self._known[kind, name] = default
                self._spent_s += time.monotonic() - begun_s
            found: T = self._known[kind, name]
            return found

    def _has_changed(self) -> bool:
        with self._node.handle, self._waits:
            self._waits.clear_entities()
            rcl().add_graph_guard(self._node.handle.pointer, self._waits.pointer)
            self._waits.wait(0)
            return bool(self._waits.get_ready_entities("guard_condition"))
