"""Ghosts of the other side's nodes and writers, which make its topics look here as they look there."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSLivelinessPolicy, QoSProfile

from arpd.adapters.ros.events import no_publisher_events
from arpd.adapters.ros.graph import policies_of
from arpd.adapters.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from arpd.apply.relay.envelope import Record
    from arpd.apply.relay.offers import WriterOffer

_MATCH_S = 0.5  # a reader on this host finds a new writer sooner
_MOST_HELD = 1000
_NO_TYPE_DESCRIPTION = Parameter("start_type_description_service", value=False)


class GhostNodes:
    """Nodes of this process with the names of the other side's nodes, each made on first use.

    Parameters
    ----------
    node : the end's own node; a ghost with its name, or a name that ROS refuses, is this node itself
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ghosts: dict[str, Node] = {}
        self._kept: dict[str, set[str]] = {}
        self._lock = threading.Lock()

    def of(self, name: str, *, owner: str) -> Node:
        """Return the ghost of the node with this fully qualified name; for any thread.

        Parameters
        ----------
        owner : keeps it from now on, so that no other thread destroys it before the caller's next `keep`
        """
        if name in {"", self._node.get_fully_qualified_name()}:
            return self._node
        with self._lock:
            self._kept.setdefault(owner, set()).add(name)
            return self._of(name)

    def served(self, name: str, *, owner: str) -> Node:
        """Return the ghost, served by the executor of the end's own node; only for the thread of that executor."""
        ghost = self.of(name, owner=owner)
        if ghost.executor is None and self._node.executor is not None:
            self._node.executor.add_node(ghost)
        return ghost

    def keep(self, owner: str, names: set[str]) -> None:
        """Destroy the ghosts that no owner keeps; the caller has destroyed their endpoints.

        Parameters
        ----------
        owner : keeps these ghosts, instead of those it kept before
        names : fully qualified names
        """
        with self._lock:
            self._kept[owner] = set(names)
            for name in self._ghosts.keys() - set().union(*self._kept.values()):
                self._ghosts.pop(name).destroy_node()

    def release(self, owner: str, names: set[str]) -> None:
        """Do as `keep`, after the executor has left the ghosts that this owner no longer keeps; as for `served`."""
        for name in self._kept.get(owner, set()) - names:
            ghost = self._ghosts.get(name)
            if ghost is not None:
                # An executor holds its nodes, destroyed ones too. `remove_node` alone would leave the node with an
                # executor that does not serve it: one that another owner keeps would never be served again.
                ghost.executor = None
        self.keep(owner, names)

    def close(self) -> None:
        """Destroy all ghosts."""
        with self._lock:
            while self._ghosts:
                self._ghosts.popitem()[1].destroy_node()

    def _of(self, name: str) -> Node:
        if name not in self._ghosts:
            namespace, _, base = name.rpartition("/")
            try:
                self._ghosts[name] = rclpy.create_node(
                    base,
                    namespace=namespace or "/",
                    context=self._node.context,
                    use_global_arguments=False,
                    enable_rosout=False,
                    start_parameter_services=False,
                    parameter_overrides=[_NO_TYPE_DESCRIPTION],
                )
            except (ValueError, RuntimeError):  # a foreign middleware may have names that rcl refuses
                return self._node
        return self._ghosts[name]


class GhostWriter:
    """The ghost of one writer: the same QoS, and every sample of that writer once and in its order.

    Its readers find it some time after it is made. Until then it holds its samples, so that none is lost.

    Parameters
    ----------
    node : ghost of the writer's node
    msg_type, topic : as in `Node.create_publisher`
    offer : QoS of the writer
    depth : KEEP_LAST depth, which discovery does not tell (samples)
    """

    def __init__(
        self,
        node: Node,
        msg_type: Any,
        topic: str,
        offer: WriterOffer,
        *,
        depth: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.offer = offer
        self._node = node
        self._clock = clock
        self._publisher = node.create_publisher(
            msg_type, topic, profile_of(offer, depth), event_callbacks=no_publisher_events()
        )
        self._outlet = rcl().outlet(self._publisher.handle)  # the lock of `Incoming` lets one thread write
        self._made_s = clock()
        self._is_found = False
        self._held: deque[bytes] = deque(maxlen=_MOST_HELD)
        self._last = 0  # number of the newest sample

    def matched(self) -> int:
        """Count its readers."""
        return int(self._publisher.get_subscription_count())

    def write(self, record: Record) -> bool:
        """Write a sample, unless it was written before; return whether it was new."""
        if record.sequence <= self._last:
            return False
        self._last = record.sequence
        if self._is_found or self._look():
            self._outlet.publish(record.sample)
        else:
            self._held.append(record.sample)
        return True

    def look(self) -> None:
        """Write the samples that it holds, once its readers have found it."""
        if not self._is_found:
            self._look()

    def destroy(self) -> None:
        """Destroy the writer."""
        self._node.destroy_publisher(self._publisher)

    def _look(self) -> bool:
        self._is_found = self.matched() > 0 or self._clock() - self._made_s > _MATCH_S
        while self._is_found and self._held:
            self._outlet.publish(self._held.popleft())
        return self._is_found


def profile_of(offer: WriterOffer, depth: int) -> QoSProfile:
    """Return the QoS of a writer."""
    return QoSProfile(
        depth=depth,
        **policies_of(is_reliable=offer.is_reliable, is_latched=offer.is_latched),
        deadline=Duration(nanoseconds=offer.deadline_ns),
        lifespan=Duration(nanoseconds=offer.lifespan_ns),
        liveliness=QoSLivelinessPolicy.MANUAL_BY_TOPIC if offer.is_manual else QoSLivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(nanoseconds=offer.lease_ns),
    )
