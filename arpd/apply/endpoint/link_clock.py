"""Link clock of a process: its large samples cross the link one at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.wire import SMALL_PACKETS

if TYPE_CHECKING:
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

_STEP = 2.0
_UNSTEADY_S = 5.0
_PATIENCE = 0.8  # periods that a sample waits at most; after a whole one its successor would replace it
_CLOSE_S = 0.0005  # to wake a thread for less costs more than it saves


class LinkClock:
    """Says when all that the publishers of a process have sent has crossed the link.

    A large sample that leaves before then only waits in the queue of the link, and small samples wait behind it. So it
    waits here, where small samples overtake it and a newer one of its topic replaces it.

    No topic loses rate by that: a sample waits for less than a period of its rate. Nor does the estimate: while a link
    changes, the queue that large samples leave tells the estimator when to look. So none waits until the capacity has
    stayed within a factor of two for 5 s.

    Notes
    -----
    Threads share it without a lock. Two that send at the same moment may count one sample for both, so that the next
    large one leaves a little early.
    """

    def __init__(self) -> None:
        self._price: Price | None = None
        self._level = 0.0  # capacity that the present one is compared with (bytes/s)
        self._stepped_s = -math.inf
        self._free_s = -math.inf

    def set_price(self, price: Price, now_s: float) -> None:
        """Take the capacity and the packet overhead that a price tells; every publisher may pass it on."""
        self._price = price
        if not self._level / _STEP < price.capacity_bytes_per_second < self._level * _STEP:
            self._level, self._stepped_s = price.capacity_bytes_per_second, now_s

    def occupy(self, plan: TopicPlan, now_s: float) -> None:
        """Count one sample that leaves now."""
        if self._price is not None and plan.wire_bytes > 0.0:
            self._free_s = max(now_s, self._free_s) + self._price.cost_s(plan)

    def turn_s(self, plan: TopicPlan, *, ready_s: float, now_s: float) -> float:
        """Return when a sample that pacing released at ``ready_s`` may leave; the past is now (s)."""
        if plan.packets <= SMALL_PACKETS or self._price is None or now_s - self._stepped_s < _UNSTEADY_S:
            return ready_s
        rate_hz = self._price.rate_hz(plan)
        latest_s = ready_s + _PATIENCE / rate_hz if plan.weight > 0.0 and rate_hz > 0.0 else ready_s
        return min(latest_s, self._free_s - _CLOSE_S)
