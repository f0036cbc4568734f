"""The price of the link: one message from which every endpoint computes its own rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from arpd.model.plan import TopicPlan, rate_of
from arpd.model.wire import SMALL_PACKETS

#: Of what is divided, the floor of all topics together whose samples take more than ten packets.
LARGE_SHARE = 0.15
_SHARE_STEP = 0.02
_GROWTH = 0.05  # of the link time, for a topic that grows until its next plan: a joystick, or a burst of log messages


@dataclass(frozen=True, kw_only=True, slots=True)
class Price:
    """Water level of (G1), with what an endpoint needs to apply it (docs/design.md, The price).

    Parameters
    ----------
    share_per_weight : ν, the share of link time that a topic of weight 1 gets, ``inf`` = as much as it wants
    capacity_bytes_per_second : C, to turn bytes into link time, > 0 (bytes/s)
    large_share_per_weight : the least share of a topic of weight 1 whose samples take more than ten packets
    packet_overhead_s : t_ovh, link time of a packet beyond its bytes (s)
    yielding_weight : topics of less weight have no floor now, and those of this weight keep a part of it
    kept_minimum : that part, 0..1
    loss_ratio : share of probe packets that the link loses, None while unknown
    budget_share, spare_share : part of the link time that all topics may take, and what none of their rates takes of
        that, for messages larger than a second's rate
    is_stale : True when nobody repeats it: a daemon that died while the link was out must not silence the robot, so no
        rate is below what its DEADLINE promises
    """

    share_per_weight: float
    capacity_bytes_per_second: float
    large_share_per_weight: float = 0.0
    packet_overhead_s: float = 0.0
    yielding_weight: float = 0.0
    kept_minimum: float = 1.0
    loss_ratio: float | None = None
    budget_share: float = 1.0
    spare_share: float = 0.0
    is_stale: bool = False

    def __post_init__(self) -> None:
        if not self.share_per_weight >= 0.0:
            raise ValueError(f"share_per_weight {self.share_per_weight!r} must be a number of at least 0")
        if not 0.0 <= self.large_share_per_weight < math.inf:
            raise ValueError(f"large_share_per_weight {self.large_share_per_weight!r} must be a number of at least 0")
        if not 0.0 < self.capacity_bytes_per_second < math.inf:
            raise ValueError(f"capacity {self.capacity_bytes_per_second!r} must be a number above 0")
        if not 0.0 <= self.packet_overhead_s < math.inf:
            raise ValueError(f"packet overhead {self.packet_overhead_s!r} must be a number of at least 0")
        if not 0.0 <= self.spare_share <= self.budget_share <= 1.0:
            raise ValueError(f"shares {self.spare_share!r} of {self.budget_share!r}: not a part of a part of the link")
        if not (0.0 <= self.yielding_weight < math.inf and 0.0 <= self.kept_minimum <= 1.0):
            raise ValueError(f"weight {self.yielding_weight!r} keeps {self.kept_minimum!r}: not a part of the floors")

    def rate_hz(self, plan: TopicPlan) -> float:
        """Return R = clip(ν·w/a, ℓ, u) for one publisher; ``plan.rate_hz`` where no price applies (Hz)."""
        return min(plan.rate_hz, self._level_hz(plan))

    def growing_hz(self, plan: TopicPlan) -> float:
        """Return R for a source that may be faster than when it was planned; what costs little has a higher ceiling."""
        if plan.weight <= 0.0 or plan.wire_bytes <= 0.0:
            return plan.rate_hz
        ceiling_hz = min(plan.max_rate_hz, max(plan.rate_hz, self._hz(_GROWTH, plan)))
        return min(ceiling_hz, self._level_hz(plan))

    def _level_hz(self, plan: TopicPlan) -> float:
        if plan.weight <= 0.0 or plan.wire_bytes <= 0.0:
            return math.inf
        return max(self.floor_hz(plan), self._hz(self.share_per_weight * plan.weight, plan))

    def _hz(self, share: float, plan: TopicPlan) -> float:
        cost_s = self.cost_s(plan)
        return share / cost_s if cost_s > 0.0 else math.inf

    def cost_s(self, plan: TopicPlan) -> float:
        """Return a, the link time of one sample (s)."""
        return self.time_s(plan.packets, plan.wire_bytes)

    def time_s(self, packets: float, wire_bytes: float) -> float:
        """Return what packets with so many bytes take of the link (s)."""
        return packets * self.packet_overhead_s + wire_bytes / self.capacity_bytes_per_second

    def floor_hz(self, plan: TopicPlan) -> float:
        """Return the floor that the link leaves one publisher (Hz)."""
        least_hz = plan.min_rate_hz
        if plan.packets > SMALL_PACKETS:
            least_hz = max(least_hz, min(plan.rate_hz, self._hz(self.large_share_per_weight * plan.weight, plan)))
        if self.is_stale:
            return max(least_hz, rate_of(plan.deadline_ns))
        if plan.weight == self.yielding_weight:  # exact: the program's classes of weight are, too
            return self.kept_minimum * least_hz
        return least_hz if plan.weight > self.yielding_weight else 0.0

    def is_near(self, other: Price, *, tolerance: float) -> bool:
        """Return whether an endpoint that has the other price needs no message.

        R = ν·C·w/(k·t_ovh·C + s), so ν·C and t_ovh·C count, each as a whole.
        """

        def near(one: float, two: float) -> bool:
            return one == two or math.isclose(one, two, rel_tol=tolerance)

        mine, theirs = self.capacity_bytes_per_second, other.capacity_bytes_per_second
        return (
            near(self.share_per_weight * mine, other.share_per_weight * theirs)
            and near(self.large_share_per_weight * mine, other.large_share_per_weight * theirs)
            and near(self.packet_overhead_s * mine, other.packet_overhead_s * theirs)
            and self.yielding_weight == other.yielding_weight
            and near(self.kept_minimum, other.kept_minimum)
            and abs(self.spare_share - other.spare_share) <= _SHARE_STEP
            and abs(self.budget_share - other.budget_share) <= _SHARE_STEP
        )
