"""Swaps: what they cost the link, and what they may."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from arpd.model.wire import swap_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from arpd.model.endpoints import PublisherState

_PART = 0.01  # of the lasting budget
_BURST_S = 30.0
_FULL = 0.9  # of the burst; the lasting budget, and so the burst, may grow all the time
# Readers beside the writers of a relay, and what every node has: parameter services, /rosout, arpd's own topics.
_ENDPOINTS_PER_PUBLISHER, _ENDPOINTS_OF_A_NODE = 2, 20


class SwapBudget:
    """Token bucket of the discovery bytes that swaps may put on the link.

    A new writer makes Fast DDS describe it to every participant, and ROS describe all endpoints of its process, and so
    does the end of the old one. So a swap costs the more, the more endpoints its process has.
    """

    def __init__(self) -> None:
        self._left = math.inf
        self._most = 0.0
        self._filled_at_s = -math.inf

    def fill(self, now_s: float, bytes_per_second: float) -> None:
        """Add what a lasting budget allows since the last time."""
        rate = _PART * bytes_per_second
        elapsed_s, self._filled_at_s = max(0.0, now_s - self._filled_at_s), now_s
        self._most = _BURST_S * rate
        self._left = max(-self._most, min(self._most, self._left + rate * min(elapsed_s, _BURST_S)))

    @property
    def has_room(self) -> bool:
        """True while a swap may begin; the last one may cost more than what is left."""
        return self._left > 0

    @property
    def is_full(self) -> bool:
        """True when enough has come together for a plan that only brings owed swaps."""
        return self._left >= _FULL * self._most

    def spend(self, costs: Mapping[str, float], names: Iterable[str]) -> None:
        """Take the costs of the swaps of these topics, also of those that could not wait."""
        self._left -= sum(costs.get(name, 0.0) for name in names)


def swap_costs(publishers: Sequence[PublisherState], *, participants: int) -> dict[str, float]:
    """Return the discovery bytes that new QoS of each topic puts on the link.

    A publisher that refuses new QoS for good costs nothing.

    Parameters
    ----------
    participants : processes across the link
    """
    of_node = Counter(publisher.node for publisher in publishers)
    costs: dict[str, float] = {}
    for publisher in publishers:
        endpoints = _ENDPOINTS_OF_A_NODE + _ENDPOINTS_PER_PUBLISHER * of_node[publisher.node]
        cost = 0.0 if publisher.refusal_reason.is_lasting else participants * swap_bytes(endpoints)
        costs[publisher.topic] = costs.get(publisher.topic, 0.0) + cost
    return costs
