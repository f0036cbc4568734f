"""(G1): what each topic costs on a link, between which bounds its rate is, and the price of a budget."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from arpd.model.allocation import Binding
from arpd.model.price import Price
from arpd.solve.level import TOLERANCE, given_up, kept_parts, yielding

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.model.allocation import Topic
    from arpd.solve.level import Column

    #: Returns ν for weights, low, high and budget.
    Find = Callable[[Column, Column, Column, float], float]

_STEP = 0.005  # of the logarithm of a budget or capacity
_LEAST_SHARE = 1e-6


class Rows:
    """The topics column by column, each of shape (N,).

    A desired rate of 0 means that nothing was measured yet, so the floor counts. A floor above the desired rate falls
    to it, because the source would miss every deadline shorter than its own period.
    """

    def __init__(self, topics: Sequence[Topic]) -> None:
        def column(name: str) -> Column:
            return np.array([getattr(topic, name) for topic in topics], dtype=float)

        self.topics = topics
        self.weights, self.wire_bytes, self.packets = column("weight"), column("wire_bytes"), column("packets")
        floors_hz, desired_hz = column("min_rate_hz"), column("desired_rate_hz")
        self.wishes_hz = np.where(desired_hz > 0.0, desired_hz, floors_hz)
        self.floors_hz = np.minimum(floors_hz, self.wishes_hz)
        self.slots, self.min_depths, self.max_depths = column("slot_bytes"), column("min_depth"), column("max_depth")
        self.latencies_s = np.nan_to_num(column("latency_budget_s"), nan=math.inf, posinf=math.inf)  # None is nan here


class Link:
    """The rows on a link.

    Parameters
    ----------
    capacity : C, ≥ 0 (bytes/s)
    packet_overhead_s : t_ovh (s)
    share : part of the capacity to divide, 0..1; with 0 all are paused

    Attributes
    ----------
    costs_s : a = k·t_ovh + s/C, link time of a message (s)
    ceilings_hz : the most that each row wants, or that the link carries of it alone (Hz)
    weights, low, high, budget : (G1), with shares e of link time
    slots, min_depths, max_depths, windows_s : (G2), with the time that a full history stands for
    """

    def __init__(self, rows: Rows, capacity: float, packet_overhead_s: float, share: float) -> None:
        self.rows, self.capacity, self.packet_overhead_s = rows, capacity, packet_overhead_s
        self.costs_s = rows.packets * packet_overhead_s + rows.wire_bytes / (capacity or 1.0)
        alone_hz = 1.0 / self.costs_s
        self.ceilings_hz = np.maximum(rows.floors_hz, np.minimum(alone_hz, rows.wishes_hz))
        self._is_wish = (rows.wishes_hz < alone_hz).tolist()
        self.weights, self.floors_hz = rows.weights, rows.floors_hz
        self.budget = share if capacity and share >= _LEAST_SHARE else 0.0
        self.low, self.high = self.costs_s * self.floors_hz, self.costs_s * self.ceilings_hz
        self.slots, self.min_depths, self.max_depths = rows.slots, rows.min_depths, rows.max_depths
        self.of_link_s, self.latencies_s = rows.max_depths * self.costs_s, rows.latencies_s

    def price(self, find: Find) -> Price:
        """Return the price of the budget: ν, or who gives way where the floors do not fit."""
        level, heaviest, kept = 0.0, 0.0, 1.0
        if not self.budget:
            heaviest, kept = float(self.weights.max()), 0.0
        elif (deficit := float(self.low.sum()) - self.budget) > TOLERANCE * self.budget:
            heaviest, kept = yielding(self.weights, self.low, deficit)
        else:
            level = find(self.weights, self.low, self.high, self.budget)
            if math.isinf(level) and self.high.max() >= 1.0:  # a ceiling of the whole link is no wish of its own
                level = float((self.high / self.weights).max())
        return Price(
            share_per_weight=level,
            capacity_bytes_per_second=self.capacity or 1.0,
            packet_overhead_s=self.packet_overhead_s,
            yielding_weight=heaviest,
            kept_floor=kept,
        )

    def rates_hz(self, price: Price) -> Column:
        """Return R = clip(ν·w/a, ℓ, u), with what a price leaves of the floors (Hz)."""
        floors_hz = self.floors_hz * kept_parts(self.weights, price.yielding_weight, price.kept_floor)
        return np.clip(price.share_per_weight * self.weights / self.costs_s, floors_hz, self.ceilings_hz)

    def most_hz(self, price: Price) -> Column:  # noqa: ARG002 - EvenLink needs it
        """Return the rates that histories are made for: the desired ones, which a moving price may reach (Hz)."""
        return np.where(np.isinf(self.rows.wishes_hz), 1.0 / self.costs_s, self.rows.wishes_hz)

    def bindings(self, rates_hz: Column) -> list[Binding]:
        """Return what stops each rate: its ceiling, its floor, or the link."""
        columns = (column.tolist() for column in (rates_hz, self.floors_hz, self.ceilings_hz))
        return [
            (Binding.DESIRED_RATE if is_wish else Binding.LINK)
            if rate_hz >= ceiling_hz
            else (Binding.FLOOR if floor_hz and math.isclose(rate_hz, floor_hz) else Binding.LINK)
            for rate_hz, floor_hz, ceiling_hz, is_wish in zip(*columns, self._is_wish, strict=True)
        ]

    def given_up(self, price: Price) -> list[str]:
        """Return in words what gives way."""
        if not self.budget:
            return ["the link has no capacity: every topic is paused"]
        return given_up("rate floor", self.weights, self.low, price.yielding_weight, price.kept_floor)


def in_steps(capacity: float, budget: float) -> tuple[float, float]:
    """Return a capacity, at least the budget (bytes/s), and the part of it that the budget is.

    Both come in steps of half a per cent, so a link that hardly moves asks the program nothing new.
    """
    budget, capacity = (math.exp(round(math.log(c) / _STEP) * _STEP) if c >= 1.0 else 0.0 for c in (budget, capacity))
    capacity = max(capacity, budget)
    return capacity, min(1.0, max(_LEAST_SHARE, round(budget / capacity, 6))) if capacity > 0.0 else 0.0
