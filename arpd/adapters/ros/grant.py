"""Generation and lease of a node's plan, and the node's answers to plans."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.bounds import checked_lease_s
from arpd.adapters.ros.names import GENERATION_PARAMETER, LEASE_PARAMETER
from arpd.adapters.ros.own_parameters import OwnParameters
from arpd.adapters.ros.plan_message import PlanAnswer, Setting
from arpd.apply.endpoint.lease import Lease
from arpd.model.plan import MOST_GENERATION

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

    from arpd.adapters.ros.plan_message import NodePlan


class Grant:
    """Generation and lease of the plan of a node's publishers, shown as two parameters.

    Parameters
    ----------
    node : declares the parameters; its owner's callbacks call `check` and `take`
    clock : monotonic clock (s)
    """

    def __init__(self, node: Node, *, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._answered = 0, ""  # hash and refusal of the last plan; one object, because two threads use it
        self.generation = 0
        self.lease = Lease()
        self._own = OwnParameters(node)
        self._own.declare(GENERATION_PARAMETER, 0, "generation of the plan in force; 0 = none, or its lease is over")
        self._own.declare(
            LEASE_PARAMETER, 0.0, "silence of arpd in s after which the publishers return to their own QoS, 0 = never"
        )

    @property
    def answer(self) -> PlanAnswer:
        """Answer to the last plan."""
        return PlanAnswer(self.generation, *self._answered)

    def check(self, parameters: Sequence[Any]) -> None:
        """Refuse a generation below the one in force or above the greatest, and a lease out of bounds.

        Raises
        ------
        ValueError
            The message names the parameter.
        """
        for parameter in parameters:
            if parameter.name == GENERATION_PARAMETER and parameter.value < self.generation:
                raise ValueError(
                    f"{parameter.name} {parameter.value} is older than {self.generation}, the plan in force"
                )
            if parameter.name == GENERATION_PARAMETER and parameter.value > MOST_GENERATION:
                raise ValueError(f"{parameter.name} {parameter.value} is more than {MOST_GENERATION}")
            if parameter.name == LEASE_PARAMETER:
                checked_lease_s(parameter)

    def take(self, parameters: Sequence[Any]) -> None:
        """Take checked parameters."""
        for parameter in parameters:
            if parameter.name == GENERATION_PARAMETER:
                self.generation = int(parameter.value)
                self.lease.renew(self._clock())  # a plan is a sign of the daemon
            elif parameter.name == LEASE_PARAMETER:
                self.lease.granted_s = float(parameter.value)

    def check_plan(self, plan: NodePlan) -> None:
        """Refuse a plan as `check` refuses parameters."""
        self.check(self._settings(plan))

    def take_plan(self, plan: NodePlan, crc: int) -> bool:
        """Take a checked plan; return whether it repeats the last one."""
        is_repeated = (plan.generation, crc, "") == self.answer
        settings = self._settings(plan)
        self.take(settings)
        self._own.show(dict(settings))
        self._answered = crc, ""
        return is_repeated

    def refuse_plan(self, crc: int, words: str) -> None:
        """Answer a plan by a refusal."""
        self._answered = crc, words

    def end(self) -> None:
        """Forget the plan: the next daemon may begin with any generation."""
        self.generation = 0
        self._own.show({GENERATION_PARAMETER: 0})

    def _settings(self, plan: NodePlan) -> list[Setting]:
        return [Setting(GENERATION_PARAMETER, plan.generation), Setting(LEASE_PARAMETER, plan.lease_s)]
