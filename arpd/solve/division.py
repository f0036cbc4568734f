"""Divides budgets among the same topics: by the program, and between two programs by the water level alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.solve.level import WaterLevel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.price import Price
    from arpd.solve.program import Program

_STEP = 0.005  # of the logarithm of a budget or capacity
_LEAST_SHARE = 1e-6  # the program divides nothing less


class Division:
    """Divides the link among topics, for as long as these and the memory stay the same.

    Budgets and capacities come in steps, so a link that hardly moves asks the program nothing new.

    Parameters
    ----------
    program : answers in full
    topics : its rows
    memory_bytes : M, memory that all histories may take (bytes)
    crossing : topics that cross the link, managed or not
    """

    def __init__(self, program: Program, topics: Sequence[Topic], *, memory_bytes: float, crossing: int) -> None:
        self._program = program
        self._topics = topics
        self._memory_bytes = memory_bytes
        self._crossing = crossing
        self._level: WaterLevel | None = None

    def allocation(self, *, capacity: float, budget: float, packet_overhead_s: float) -> Allocation:
        """Divide a budget of a capacity by the program (bytes/s)."""
        capacity, share = _part(capacity, budget)
        return self._program.solve(
            capacity,
            self._topics,
            self._memory_bytes,
            packet_overhead_s=packet_overhead_s,
            share=share,
            crossing=self._crossing,
        )

    def price(self, *, capacity: float, budget: float, packet_overhead_s: float) -> tuple[Price | None, float]:
        """Return the price of a division, None without topics, and the budget that it divides (bytes/s)."""
        if not self._topics or self._program.is_uniform:
            answer = self.allocation(capacity=capacity, budget=budget, packet_overhead_s=packet_overhead_s)
            return answer.price, answer.capacity_bytes_per_second
        self._level = self._level or WaterLevel(self._topics)
        capacity, share = _part(capacity, budget)
        return self._level.price(capacity, packet_overhead_s=packet_overhead_s, share=share), capacity * share


def _part(capacity: float, budget: float) -> tuple[float, float]:
    """Return the capacity to divide, at least the budget (bytes/s), and the part of it that the budget is."""
    budget = _stepped(budget)
    capacity = max(_stepped(capacity), budget)
    return capacity, min(1.0, max(_LEAST_SHARE, round(budget / capacity, 6))) if capacity > 0.0 else 0.0


def _stepped(bytes_per_second: float) -> float:
    """Return a rate rounded to steps of half a per cent, 0 below 1 byte/s."""
    return math.exp(round(math.log(bytes_per_second) / _STEP) * _STEP) if bytes_per_second >= 1.0 else 0.0
