"""Generation and lease of a node's plan, as parameters that the daemon sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.bounds import checked_lease_s
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.apply.endpoint.lease import Lease
from arpd.model.plan import MOST_GENERATION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node


class Grant:
    """Generation and lease of the plan of a node's publishers, or of its readers, as two parameters.

    Parameters
    ----------
    node : declares the parameters; its owner's callbacks call `check` and `take`
    generation_name, lease_name : names of the parameters
    plan, whose : the plan, and the endpoints whose own QoS returns after the lease, in words
    clock : monotonic clock (s)
    """

    def __init__(
        self, node: Node, *, generation_name: str, lease_name: str, plan: str, whose: str, clock: Callable[[], float]
    ) -> None:
        self._generation_name, self._lease_name = generation_name, lease_name
        self._clock = clock
        self.generation = 0
        self.lease = Lease()
        own = OwnParameters.of(node)
        own.declare(generation_name, 0, f"generation of the {plan}; 0 = none, or its lease is over")
        own.declare(lease_name, 0.0, f"silence of arpd in s after which the {whose} return to their own QoS, 0 = never")

    def check(self, parameters: Sequence[Any]) -> None:
        """Refuse a generation below the one in force or above the greatest, and a lease out of bounds.

        Raises
        ------
        ValueError
            The message names the parameter.
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
        """Take checked parameters."""
        for parameter in parameters:
            if parameter.name == self._generation_name:
                self.generation = int(parameter.value)
                self.lease.renew(self._clock())  # a plan is a sign of the daemon
            elif parameter.name == self._lease_name:
                self.lease.granted_s = float(parameter.value)
