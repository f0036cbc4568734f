"""The uniform policy: Eq. (4) of the paper on the live link, with one rate and one depth for all topics.

Design: docs/design.md, The program.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from arpd.model.allocation import Uniform
from arpd.solve.level import TOLERANCE, left
from arpd.solve.link import Link

if TYPE_CHECKING:
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price
    from arpd.solve.level import Column
    from arpd.solve.link import Find, Rows

# Terms of every row of a uniform plan. Equal terms give every publisher the same rate. They never change, so the price
# alone moves the rate, also when a topic comes or a message grows, and no plan is needed for that.
_WEIGHT, _WIRE_BYTES, _PACKETS = 1.0, 1000.0, 0


def alike(row: TopicPlan) -> TopicPlan:
    """Return a row of a uniform plan: its terms are those of every other row, so the price gives all one rate."""
    return replace(row, weight=_WEIGHT, wire_bytes=_WIRE_BYTES, packets=_PACKETS)


class EvenLink(Link):
    """The rows on a link, made alike: with identical topics, (G1) and (G2) are Eq. (4).

    Rmax is the rate at which one topic alone fills the divided part of the link: 1 over the mean link time of a message
    of these topics. Rmin, Dmin and Dmax are the largest of the topics, and N counts every topic that crosses the link.

    Where (2) cannot be met, the rate reserve gives way, then Rmin, by no more than they must. So R never rises while
    the capacity falls, and N topics at R always fit. A source that is slower than R keeps its own period. What it
    leaves goes to nobody, as in the paper.

    Parameters
    ----------
    crossing : topics that cross the link, managed or not
    """

    def __init__(self, rows: Rows, capacity: float, packet_overhead_s: float, share: float, *, crossing: int) -> None:
        super().__init__(rows, capacity, packet_overhead_s, share)
        alike, count = np.ones_like(rows.weights), len(rows.topics)
        self._topics = max(crossing, count)
        self._cost = float(self.costs_s.mean()) / (self.budget or 1.0)  # 1/Rmax
        self.weights, self.floors_hz = alike, rows.floors_hz.max() * alike
        self.low, self.high = self._cost * self.floors_hz, alike
        floors, even = float(self.low.sum()), count / self._topics if self.budget else 0.0
        self._reserve_left = min(1.0, max(0.0, even - floors) / floors) if floors else 1.0
        self.budget = max(even - floors, min(even, floors))
        self.slots, self.min_depths = rows.slots.mean() * alike, rows.min_depths.max() * alike
        self.max_depths, self.latencies_s = rows.max_depths.max() * alike, rows.latencies_s.min() * alike
        self.of_link_s = self._cost * self.max_depths

    def price(self, find: Find) -> Price:
        """Return the price at which every row of a uniform plan has the rate R."""
        price = super().price(find)
        rate_hz = max(price.share_per_weight / self._cost, price.kept_floor * float(self.floors_hz[0]))
        level = rate_hz * _WIRE_BYTES / (_WEIGHT * price.capacity_bytes_per_second)
        return replace(price, share_per_weight=level, packet_overhead_s=0.0)

    def rates_hz(self, price: Price) -> Column:
        """Return R for all but slower sources (Hz)."""
        return np.minimum(self._rate_hz(price), self.ceilings_hz)

    def most_hz(self, price: Price) -> Column:
        """Return R, which (3) makes histories for (Hz)."""
        return np.full_like(self.weights, self._rate_hz(price))

    def given_up(self, price: Price) -> list[str]:
        """Return in words what gives way, the rate reserve first."""
        is_whole = not self.budget or self._reserve_left >= 1.0 - TOLERANCE
        return [*([] if is_whole else [f"rate reserve {left(self._reserve_left)}"]), *super().given_up(price)]

    def uniform(self, price: Price, depth: int) -> Uniform:
        """Return N, Rmax, R and D."""
        return Uniform(
            topics=self._topics,
            max_rate_hz=1.0 / self._cost if self.budget else 0.0,
            rate_hz=self._rate_hz(price),
            depth=depth,
        )

    def _rate_hz(self, price: Price) -> float:
        return price.share_per_weight * price.capacity_bytes_per_second * _WEIGHT / _WIRE_BYTES
