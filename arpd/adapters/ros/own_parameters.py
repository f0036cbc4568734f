"""arpd's parameters on a node of the application."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterAlreadyDeclaredException
from rclpy.parameter import Parameter

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rclpy.node import Node

_TABLES = ("_parameters", "_descriptors", "_parameter_overrides")


class OwnParameters:
    """Declares arpd's parameters of one node, and shows in them what a plan brought into force.

    rclpy 7.1 declares a parameter in 44 µs and sets one in 18 µs, asks every callback, and publishes each change
    reliably to every process that listens: an event of more than 100 kB for a plan of 250 topics. A plan is checked
    before it is shown, so this class writes into the node's own tables, in 4 and 2 µs. What people set goes the usual
    way, with events.

    Parameters
    ----------
    node : node of the application
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        # The node's own tables; rclpy gives them no public names.
        self._values, self._descriptors, self._overrides = (vars(node)[name] for name in _TABLES)

    def declare(self, name: str, value: float, description: str) -> None:
        """Declare a parameter, as `Node.declare_parameter` does, but without callbacks and events.

        Raises
        ------
        ParameterAlreadyDeclaredException
            If it is the application's.
        """
        descriptor = ParameterDescriptor(description=description)
        if name in self._overrides:  # rclpy knows how to read it
            self._node.declare_parameter(name, value, descriptor)
            return
        if self._node.has_parameter(name):
            raise ParameterAlreadyDeclaredException(name)
        parameter = Parameter(name, value=value)
        descriptor.name, descriptor.type = name, parameter.type_.value
        self._descriptors[name] = descriptor
        self._values[name] = parameter

    def show(self, values: Mapping[str, float]) -> None:
        """Set declared parameters to checked values, without callbacks and events."""
        known = self._values
        known.update({name: Parameter(name, value=value) for name, value in values.items() if name in known})

    def undeclare(self, name: str) -> None:
        """Undeclare a parameter, if it is still declared."""
        if self._node.context.ok() and self._node.has_parameter(name):
            self._node.undeclare_parameter(name)
