"""What a daemon grants one node: a plan of some generation, and for how long it outlives the daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ParameterDescriptor

from arpd.adapters.ros.bounds import checked_lease_s
from arpd.apply.endpoint.lease import Lease
from arpd.model.plan import MOST_GENERATION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node


class Grant:
    """Generation and lease of the plan that a node's publishers, or its readers, run with, as two parameters.

    Parameters
    ----------
    node : on which the parameters are declared; its owner's callbacks call `check` and `take`
    generation_name, lease_name : names of the parameters
    plan, whose : which plan it is, and whose QoS returns when its lease is over, in words
    clock : monotonic clock (s)
    """

    def __init__(
        self, node: Node, *, generation_name: str, lease_name: str, plan: str, whose: str, clock: Callable[[], float]
    ) -> None:
        self._generation_name, self._lease_name = generation_name, lease_name
        self._clock = clock
        self.generation = 0
        self.lease = Lease()
        description = f"generation of the {plan}; 0 = none, or its lease is over"
        node.declare_parameter(generation_name, 0, ParameterDescriptor(description=description))
        description = f"silence of arpd in s after which the {whose} return to their own QoS, 0 = never"
        node.declare_parameter(lease_name, 0.0, ParameterDescriptor(description=description))

    def check(self, parameters: Sequence[Any]) -> None:
        """Refuse a plan that is older than the one in force, a number beyond all plans, and a lease that is no time.

        Raises
        ------
        ValueError
            If one of them is; the message names the parameter.
        """
        for parameter in parameters:
            if parameter.name == self._generation_name and parameter.value < self.generation:
                raise ValueError(
                    f"{parameter.name} {parameter.value} is older than {self.generation}, the plan in force"
                )
            if parameter.name == self._generation_name and parameter.value > MOST_GENERATION:
                raise ValueError(f"{parameter.name} {parameter.value} is more than {MOST_GENERATION}")
            if parameter.name == self._lease_name:
                checked_lease_s(parameter)

    def take(self, parameters: Sequence[Any]) -> None:
        """Take what was checked."""
        for parameter in parameters:
            if parameter.name == self._generation_name:
                self.generation = int(parameter.value)
                self.lease.renew(self._clock())  # who sends a plan is there
            elif parameter.name == self._lease_name:
                self.lease.granted_s = float(parameter.value)
