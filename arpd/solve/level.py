"""The water level of (G1) in floats: the price between two programs, in some tens of microseconds at any size."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from arpd.model.price import Price

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from arpd.model.allocation import Topic


class WaterLevel:
    """Gives the price at which some topics fill a budget.

    The program answers the same question exactly, with every rate, period and depth, in 1 ms for 12 topics and 30 ms
    for 1,000. The price follows the link many times a second, and needs ν alone; ``tests/agreement`` holds both
    answers together.

    Parameters
    ----------
    topics : rows of the program
    """

    def __init__(self, topics: Sequence[Topic]) -> None:
        self.topics = topics
        self._weights = np.array([topic.weight for topic in topics], dtype=float)
        self._wire_bytes = np.array([topic.wire_bytes for topic in topics], dtype=float)
        self._packets = np.array([topic.packets for topic in topics], dtype=float)
        floors = np.array([topic.min_rate_hz for topic in topics], dtype=float)
        desired = np.array([topic.desired_rate_hz for topic in topics], dtype=float)
        self._ceilings_hz = np.where(desired > 0.0, desired, floors)
        self._floors_hz = np.minimum(floors, self._ceilings_hz)

    def price(self, capacity_bytes_per_second: float, *, packet_overhead_s: float, share: float) -> Price:
        """Return the price, as `Program.solve` would: ν, or the floors that give way where not all of them fit.

        Parameters
        ----------
        capacity_bytes_per_second : C, after cross traffic and before headroom, ≥ 0 (bytes/s); with 0 all are paused
        packet_overhead_s : t_ovh (s)
        share : B, part of the capacity to divide, 0..1
        """
        if capacity_bytes_per_second <= 0.0:
            heaviest = float(self._weights.max())
            return Price(share_per_weight=0.0, capacity_bytes_per_second=1.0, yielding_weight=heaviest, kept_floor=0.0)
        cost_s = self._packets * packet_overhead_s + self._wire_bytes / capacity_bytes_per_second
        low = cost_s * self._floors_hz
        high = np.maximum(low, np.minimum(1.0, cost_s * self._ceilings_hz))
        level, yielding, kept = 0.0, 0.0, 1.0
        if (deficit := float(low.sum()) - share) > 0.0:
            yielding, kept = _yielding(low, self._weights, deficit)
        else:
            level = _level(low, high, self._weights, share)
        return Price(
            share_per_weight=level,
            capacity_bytes_per_second=capacity_bytes_per_second,
            packet_overhead_s=packet_overhead_s,
            yielding_weight=yielding,
            kept_floor=kept,
        )


def _level(low: NDArray[np.float64], high: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Return the largest ν with Σ clip(ν·w, low, high) ≤ share; ``inf`` when everybody has all that it asks for."""
    if float(high.sum()) <= share:
        return math.inf if float(high.max()) < 1.0 else float((high / weights).max())
    # The sum is piecewise linear in ν: its slope grows by w at low/w and falls by w at high/w.
    bends = np.concatenate((low / weights, high / weights))
    order = np.argsort(bends)
    levels = bends[order]
    slopes = np.cumsum(np.concatenate((weights, -weights))[order])
    sums = float(low.sum()) + np.concatenate(((0.0,), np.cumsum(slopes[:-1] * np.diff(levels))))
    last = max(0, int(np.searchsorted(sums, share, side="right")) - 1)
    slope = float(slopes[last])
    return float(levels[last]) + ((share - float(sums[last])) / slope if slope > 0.0 else 0.0)


def _yielding(low: NDArray[np.float64], weights: NDArray[np.float64], deficit: float) -> tuple[float, float]:
    """Return the heaviest weight whose floors give way, and the part of them that is kept: light weights go first."""
    heaviest, kept = 0.0, 1.0
    for weight in np.unique(weights[low > 0.0]).tolist():
        if deficit <= 0.0:
            break
        total = float(low[weights == weight].sum())
        heaviest, kept = weight, max(0.0, total - deficit) / total
        deficit -= total
    return heaviest, kept
