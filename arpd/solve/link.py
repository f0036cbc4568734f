"""(G1) and (G2): what each topic costs on a link, the bounds of its rate and its history, and the division."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from arpd.model.allocation import Binding, Topic, Uniform
from arpd.model.price import LARGE_SHARE, Price
from arpd.model.wire import SMALL_PACKETS
from arpd.solve.level import TOLERANCE, Column, Yielding, water_level, yielding

#: Returns ν for weights, low, high and budget.
Find = Callable[[Column, Column, Column, float], float]
_LEAST_SHARE = 1e-6
NO_CAPACITY = "the link has no capacity: every topic is paused"


class Rows:
    """The topics column by column, each of shape (N,)."""

    def __init__(self, topics: Sequence[Topic]) -> None:
        def column(name: str) -> Column:
            return np.array([getattr(topic, name) for topic in topics], dtype=float)

        self.topics = topics
        self.weights, self.wire_bytes, self.packets = column("weight"), column("wire_bytes"), column("packets")
        self.floors_hz, self.wishes_hz = column("min_rate_hz"), column("desired_rate_hz")
        self.are_large = self.packets > SMALL_PACKETS
        self.slots, self.min_depths, self.max_depths = column("slot_bytes"), column("min_depth"), column("max_depth")
        self.latencies_s = np.nan_to_num(column("latency_budget_s"), nan=math.inf, posinf=math.inf)  # None is nan here


class Division(NamedTuple):
    """The link and the memory divided: rates (Hz), depths (samples), and what gave way, in words."""

    price: Price
    rates_hz: Column
    depths: Column
    depth_bindings: list[Binding]
    given_up: list[str]
    uniform: Uniform | None = None


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
    ceilings_hz : the most that each row wants; twice what the link carries of it stands for all that is more (Hz)
    floors_hz : the minimum rate that is asked for each row (Hz)
    large_level : the level at which the large rows take their part of the budget
    least_hz : the floor of each row: what is asked, and of large ones what that level gives (Hz)
    """

    def __init__(self, rows: Rows, capacity: float, packet_overhead_s: float, share: float) -> None:
        self.rows, self.capacity, self.packet_overhead_s, self.share = rows, capacity, packet_overhead_s, share
        self.costs_s = rows.packets * packet_overhead_s + rows.wire_bytes / (capacity or 1.0)
        self.floors_hz = rows.floors_hz
        self.ceilings_hz = np.maximum(rows.floors_hz, np.minimum(rows.wishes_hz, 2.0 / self.costs_s))
        self.budget = share if capacity and share >= _LEAST_SHARE else 0.0
        self.large_level = self._large_level()
        least_hz = np.where(rows.are_large, self.large_level * rows.weights / self.costs_s, 0.0)
        self.least_hz = np.clip(least_hz, rows.floors_hz, self.ceilings_hz)

    def price(self, find: Find = water_level) -> Price:
        """Return the price of the budget: ν, or who gives way where the floors do not fit."""
        rows, low = self.rows, self.costs_s * self.least_hz
        if not self.budget:
            return self.priced(0.0, Yielding(float(rows.weights.max()), 0.0))
        if (deficit := float(low.sum()) - self.budget) > TOLERANCE * self.budget:
            return self.priced(0.0, yielding(rows.weights, low, deficit))
        return self.priced(find(rows.weights, low, self.costs_s * self.ceilings_hz, self.budget), Yielding())

    def divide(self, memory_bytes: float, find: Find) -> Division:
        """Return R = clip(ν·w/a, ℓ, u), with what the price leaves of the floors, and the histories of `_histories`."""
        price, rows = self.price(find), self.rows
        floors = Yielding(price.yielding_weight, price.kept_minimum)
        level_hz = price.share_per_weight * rows.weights / self.costs_s
        rates_hz = np.clip(level_hz, self.least_hz * floors.parts(rows.weights), self.ceilings_hz)
        words = floors.words("minimum rate", rows.weights, self.least_hz) if self.budget else [NO_CAPACITY]
        depths, bindings, cut = self._histories(memory_bytes, find)
        return Division(price, rates_hz, depths, bindings, words + cut)

    def bindings(self, rates_hz: Column) -> list[Binding]:
        """Return what stops each rate: its ceiling, its floor, or the link."""
        is_full, is_floor = rates_hz >= self.ceilings_hz, np.isclose(rates_hz, self.floors_hz, rtol=1e-9, atol=0.0)
        found = np.select(
            [is_full, is_floor & (self.floors_hz > 0.0)], [Binding.DESIRED_RATE, Binding.MINIMUM], Binding.LINK
        )
        return [Binding(each) for each in found.tolist()]

    def _large_level(self) -> float:
        large, weights, asked = self.rows.are_large, self.rows.weights, self.costs_s * self.floors_hz
        if not large.any():
            return 0.0
        high = (self.costs_s * self.ceilings_hz)[large]
        part = min(LARGE_SHARE * self.budget, self.budget - float(asked[~large].sum()))
        level = water_level(weights[large], asked[large], high, part)
        return min(level, float((high / weights[large]).max()))

    def priced(self, level: float, floors: Yielding) -> Price:
        """Return the price of a level on this link."""
        return Price(
            share_per_weight=level,
            capacity_bytes_per_second=self.capacity or 1.0,
            large_share_per_weight=self.large_level,
            packet_overhead_s=self.packet_overhead_s,
            yielding_weight=floors.weight,
            kept_minimum=floors.kept,
        )

    def _histories(self, memory_bytes: float, find: Find) -> tuple[Column, list[Binding], list[str]]:
        """Return D = clip(λ·w/m, Dmin, min(Dmax, τ·u − δ)) with Σ m·D ≤ M, what stops each, and what gives way.

        τ = Dmax·a, at most the latency budget, is the time that a full history stands for, and δ = Dmin is the reserve
        of (3). Where the floor and δ collide, δ shrinks, so the depth is continuous and monotone in the rate.
        """
        rows, slots, least = self.rows, self.rows.slots, self.rows.min_depths
        of_link_s = rows.max_depths * self.costs_s
        justified = np.minimum(of_link_s, rows.latencies_s) * rows.wishes_hz - least
        most = np.clip(justified, least, rows.max_depths)
        # One sample is the least that a history can hold, so only what is above it gives way.
        spare, deficit = slots * (least - 1.0), float((slots * least).sum()) - memory_bytes
        floors, level = Yielding(), 0.0
        if deficit > TOLERANCE * memory_bytes:
            floors = yielding(rows.weights, spare, deficit)
        else:
            level = find(rows.weights, slots * least, slots * most, memory_bytes)
        words = floors.words("minimum depth", rows.weights, spare)
        if is_short := slots.sum() > memory_bytes * (1.0 + TOLERANCE):
            words.append("memory budget below one sample per topic")
        kept = 1.0 + (least - 1.0) * floors.parts(rows.weights)
        depths = np.clip(level * rows.weights / slots, kept, most)
        ceilings = np.select(
            [justified < least, justified >= rows.max_depths, rows.latencies_s < of_link_s],
            [Binding.MINIMUM, Binding.MAX_DEPTH, Binding.LATENCY_BUDGET],
            Binding.LINK,
        )
        lacks_memory = is_short | (depths < least)
        bindings = np.select(
            [lacks_memory, depths >= most, depths > least], [Binding.MEMORY, ceilings, Binding.MEMORY], Binding.MINIMUM
        )
        return depths, [Binding(each) for each in bindings.tolist()], words
