"""The closed form of (G1) and (G2) in floats: the water level ν, and who gives way where the floors do not fit."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

Column = np.ndarray[Any, np.dtype[np.float64]]
#: Part of a budget by which a sum may miss it.
TOLERANCE = 1e-6


def water_level(weights: Column, low: Column, high: Column, budget: float) -> float:
    """Return the largest ν with Σ clip(ν·w, low, high) ≤ budget; ``inf`` where all ceilings fit."""
    if float(high.sum()) <= budget:
        return math.inf
    # The sum is piecewise linear in ν: its slope grows by w at low/w and falls by w at high/w.
    bends = np.concatenate((low / weights, high / weights))
    order = np.argsort(bends)
    levels = bends[order]
    slopes = np.cumsum(np.concatenate((weights, -weights))[order])
    sums = float(low.sum()) + np.concatenate(((0.0,), np.cumsum(slopes[:-1] * np.diff(levels))))
    last = max(0, int(np.searchsorted(sums, budget, side="right")) - 1)
    slope = float(slopes[last])
    return max(0.0, float(levels[last]) + ((budget - float(sums[last])) / slope if slope > 0.0 else 0.0))


def residual(level: float, weights: Column, low: Column, high: Column, budget: float) -> float:
    """Return by what part of the budget Σ clip(ν·w, low, high) misses it; nan for a level that is no number.

    Shares of that form meet every other condition of optimality, so this one number proves ν right or wrong.
    """
    return abs(float(np.clip(level * weights, low, high).sum()) / budget - 1.0)


class Yielding(NamedTuple):
    """The floors that give way: all of lighter rows, and of rows of this weight all but a part."""

    weight: float = 0.0
    kept: float = 1.0

    def parts(self, weights: Column) -> Column:
        """Return the part of its floor that each row keeps, 0..1."""
        return np.where(weights > self.weight, 1.0, np.where(weights == self.weight, self.kept, 0.0))

    def words(self, floor: str, weights: Column, low: Column) -> list[str]:
        """Return what gives way, in words."""
        if not self.weight:
            return []
        classes = np.unique(weights[(low > 0.0) & (weights <= self.weight)]).tolist()
        return [f"{floor} of weight {w:g} {left(self.kept if w == self.weight else 0.0)}" for w in classes]


def yielding(weights: Column, low: Column, deficit: float) -> Yielding:
    """Return which floors give way to a deficit, none where there is none: light rows first."""
    found = Yielding()
    for weight in np.unique(weights[low > 0.0]).tolist():
        if deficit <= 0.0:
            break
        total = float(low[weights == weight].sum())
        found = Yielding(weight, max(0.0, total - deficit) / total)
        deficit -= total
    return found


def left(part: float) -> str:
    """Return in words what is left of something that gives way, 0..1."""
    return f"cut to {part:.0%}" if part else "given up"
