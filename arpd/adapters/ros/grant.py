"""Generation and lease of a node's plan, and the node's answers to plans."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.adapters.ros.bounds import check_grant
from arpd.adapters.ros.plan_message import PlanAnswer

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.ros.plan_message import NodePlan


class Lease:
    """Time since the last sign of the daemon, against the time it granted; pure, in seconds of one monotonic clock."""

    def __init__(self) -> None:
        self.granted_s = 0.0
        self._heard_at_s = -math.inf

    def renew(self, now_s: float) -> None:
        """Note a sign of the daemon."""
        self._heard_at_s = max(self._heard_at_s, now_s)

    def is_silent(self, now_s: float, *, for_s: float) -> bool:
        """Return whether the last sign is older than ``for_s``, or there was none."""
        return now_s - self._heard_at_s > for_s

    def is_over(self, now_s: float) -> bool:
        """Return whether the lease has run out; a grant of 0 never does."""
        return self.granted_s > 0 and self.is_silent(now_s, for_s=self.granted_s)


class Grant:
    """The plan that a node's publishers have: its number, how long it lasts, and the node's answer.

    Parameters
    ----------
    clock : monotonic clock (s)

    Attributes
    ----------
    generation : number of the plan in force, 0 = there is none
    lease : how long the plan outlives its daemon
    """

    def __init__(self, *, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._answered = 0, ""  # hash and refusal of the last plan; one object, because two threads use it
        self.generation = 0
        self.lease = Lease()

    @property
    def answer(self) -> PlanAnswer:
        """Answer to the last plan."""
        return PlanAnswer(self.generation, *self._answered)

    def check(self, plan: NodePlan) -> None:
        """Refuse a plan that the node cannot take.

        Raises
        ------
        ValueError
            If it is refused.
        """
        check_grant(generation=plan.generation, lease_s=plan.lease_s, in_force=self.generation)

    def take(self, plan: NodePlan, crc: int) -> bool:
        """Take a checked plan; return whether it repeats the last one."""
        is_repeated = (plan.generation, crc, "") == self.answer
        self.generation = plan.generation
        self.lease.granted_s = plan.lease_s
        self.lease.renew(self._clock())  # a plan is a sign of the daemon
        self._answered = crc, ""
        return is_repeated

    def refuse(self, crc: int, words: str) -> None:
        """Answer a plan by a refusal."""
        self._answered = crc, words

    def end(self) -> None:
        """Forget the plan: the next daemon may begin with any generation."""
        self.generation = 0
