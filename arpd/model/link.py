"""What the estimator believes of the link."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

# A flow that adapts, as TCP does, takes whatever it is left: yielding all of it would push the robot down to its floors
# step by step. Half is what two equal flows would share.
MOST_YIELDED = 0.5


class CapacityKind(StrEnum):
    """How the capacity estimate was made, best evidence first."""

    PEER = "peer"
    LOCAL = "local"
    RADIO = "radio"
    CONFIGURED = "configured"


class LinkState(StrEnum):
    """What the link is doing, as far as the estimator can tell."""

    STEADY = "steady"
    APP_LIMITED = "app_limited"
    CONGESTED = "congested"
    DRAINING = "draining"
    OUTAGE = "outage"


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkEstimate:
    """What the estimator believes of the link.

    Parameters
    ----------
    capacity_bytes_per_second : wire bytes the link carries (bytes/s), ≥ 0
    kind : how it was made
    state : what the link is doing
    queue_delay_s : one-way delay above its 10 s minimum (s)
    queue_allowance_s : delay that does not mean a standing queue: one large message passing explains it (s)
    delivery_rate_bytes_per_second : what the peer received over the last 300 ms (bytes/s)
    age_s : time since the evidence behind the capacity (s)
    evidence : the last change, in words
    packet_overhead_s : t_ovh, link time each packet costs beyond its bytes (s)
    cross_traffic_bytes_per_second : what the link carries that arpd's topics and probes do not explain (bytes/s)
    loss_ratio : share of the probe packets of late that never arrived, None while too few were sent to tell
    return_delay_s : one-way delay of the peer's reports above its minimum of late: what a command to the robot waits,
        None without a peer (s)
    events_by_kind : how often each rule changed the estimate, or an outage began, since the start
    """

    capacity_bytes_per_second: float
    kind: CapacityKind
    state: LinkState
    queue_delay_s: float
    delivery_rate_bytes_per_second: float
    age_s: float
    evidence: str
    queue_allowance_s: float = 0.05
    cross_traffic_bytes_per_second: float = 0.0
    packet_overhead_s: float = 0.0
    loss_ratio: float | None = None
    return_delay_s: float | None = None
    events_by_kind: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def available_bytes_per_second(self) -> float:
        """What is left of the capacity for arpd's topics (bytes/s)."""
        capacity = self.capacity_bytes_per_second
        return capacity - min(self.cross_traffic_bytes_per_second, MOST_YIELDED * capacity)

    @property
    def available_packet_overhead_s(self) -> float:
        """What a packet costs of the link time that is left, as if all of it were arpd's (s)."""
        available = self.available_bytes_per_second
        return self.packet_overhead_s * self.capacity_bytes_per_second / available if available > 0 else 0.0

    @property
    def is_app_limited(self) -> bool:
        """Whether traffic alone says nothing about capacity now."""
        return self.state is LinkState.APP_LIMITED


class EstimatorEvent(StrEnum):
    """Which rule changed the estimate (docs/design.md, The estimator), or that the link fell silent."""

    FIRST = "first"  # the first trains replace what was configured
    DOWN = "down"  # a queue stands: what is delivered is the capacity
    UNDO = "undo"  # trains contradict the last fall
    AGREE = "agree"  # two trains see clearly more
    CARRIED = "carried"  # clearly more than was believed arrived
    FOLLOW = "follow"  # a step towards what trains see, either way
    RESUME = "resume"  # reports came back after an outage
    OUTAGE = "outage"  # reports ceased
    LOCAL = "local"  # no peer: the queue of this host's interface said it
