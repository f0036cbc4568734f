"""arpd's parameters on a node of the application."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent

from arpd.adapters.ros.attached import attached

if TYPE_CHECKING:
    from rclpy.node import Node

_KINDS = ("new_parameters", "changed_parameters", "deleted_parameters")


class OwnParameters:
    """Declares arpd's parameters of one node, and keeps them out of its ParameterEvents.

    A node publishes each change of its parameters, reliably, once to every process that listens. A plan for 250 topics
    would be an event of more than 100 kB, on the link that has just fallen. rclpy 7.1 has no option for that, so this
    class puts a filter before the `publish` of the node's event publisher. The parameter services work as ever, and
    the application's parameters have their events.

    Parameters
    ----------
    node : node of the application; use `of`, so that a node has one filter
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._names: set[str] = set()
        # rclpy makes it before any other publisher of the node.
        publisher: Any = next((each for each in node.publishers if each.msg_type is ParameterEvent), None)
        if publisher is not None:
            self._publish = publisher.publish
            publisher.publish = self._publish_others

    @classmethod
    def of(cls, node: Node) -> OwnParameters:
        """Return the node's own, made on first use and stored on the node."""
        return attached(node, cls, lambda: cls(node))

    def declare(self, name: str, value: float, description: str) -> None:
        """Declare a parameter, as `Node.declare_parameter` does."""
        self._names.add(name)
        try:
            self._node.declare_parameter(name, value, ParameterDescriptor(description=description))
        except Exception:
            self._names.discard(name)  # it may be the application's
            raise

    def undeclare(self, name: str) -> None:
        """Undeclare a parameter, if it is still declared."""
        self._names.discard(name)
        if self._node.context.ok() and self._node.has_parameter(name):
            self._node.undeclare_parameter(name)

    def _publish_others(self, event: Any) -> None:
        """Publish an event without arpd's parameters, if there is anything else in it."""
        others = {kind: [each for each in getattr(event, kind) if each.name not in self._names] for kind in _KINDS}
        if any(others.values()):
            for kind, parameters in others.items():
                setattr(event, kind, parameters)
            self._publish(event)
