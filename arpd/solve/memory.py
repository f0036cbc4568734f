"""(G2): how much history each topic may have, and the division of the memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from arpd.model.allocation import Binding
from arpd.solve.level import TOLERANCE, given_up, kept_parts, yielding

if TYPE_CHECKING:
    from arpd.solve.level import Column
    from arpd.solve.link import Find, Link


class Histories(NamedTuple):
    """Depth of each row (samples), what stops it, and which depth floors give way, in words."""

    depths: Column
    bindings: list[Binding]
    given_up: list[str]


def divide_memory(link: Link, most_hz: Column, memory_bytes: float, find: Find) -> Histories:
    """Return D = clip(λ·w/m, Dmin, min(Dmax, τ·u − δ)) with Σ m·D ≤ M; depth floors that do not fit give way.

    τ = Dmax·a, at most the latency budget, is the time that a full history stands for, and δ = Dmin is the reserve of
    (3). Where the floor and δ collide, δ shrinks, so the depth is continuous and monotone in the rate.

    Parameters
    ----------
    most_hz : u, the rates to make histories for
    memory_bytes : M
    find : returns λ
    """
    weights, slots, least = link.weights, link.slots, link.min_depths
    low = slots * least
    if (deficit := float(low.sum()) - memory_bytes) > TOLERANCE * memory_bytes:
        return _cut(link, memory_bytes, deficit)
    justified = np.minimum(link.of_link_s, link.latencies_s) * most_hz - least
    most = np.clip(justified, least, link.max_depths)
    level = find(weights, low, slots * most, memory_bytes)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depths = np.where(slots > 0.0, np.clip(level * weights / slots, least, most), most)
    ceilings = np.select(
        [justified < least, justified >= link.max_depths, link.latencies_s < link.of_link_s],
        [Binding.FLOOR, Binding.MAX_DEPTH, Binding.LATENCY_BUDGET],
        Binding.LINK,
    )
    bindings = np.select([depths >= most, depths > least], [ceilings, Binding.MEMORY], Binding.FLOOR)
    return Histories(depths, [Binding(each) for each in bindings.tolist()], [])


def _cut(link: Link, memory_bytes: float, deficit: float) -> Histories:
    """Give up depth floors, down to one sample, the least that a history can hold."""
    spare = link.slots * (link.min_depths - 1.0)
    heaviest, kept = yielding(link.weights, spare, deficit)
    parts = kept_parts(link.weights, heaviest, kept)
    notes = given_up("depth floor", link.weights, spare, heaviest, kept)
    if is_short := link.slots.sum() > memory_bytes:
        notes.append("memory budget below one sample per topic")
    bindings = [Binding.MEMORY if is_short or part < 1.0 else Binding.FLOOR for part in parts.tolist()]
    return Histories(1.0 + (link.min_depths - 1.0) * parts, bindings, notes)
