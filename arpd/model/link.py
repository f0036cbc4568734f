"""Estimate of the link."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

# A flow that adapts, as TCP does, takes all that arpd leaves it: yielding everything would push the robot down to its
# floors step by step. Half is what two equal flows would share.
MOST_YIELDED = 0.5


class CapacityKind(StrEnum):
    """Source of the capacity estimate, best evidence first."""

    PEER = "peer"
    LOCAL = "local"
    RADIO = "radio"
    CONFIGURED = "configured"


class LinkState(StrEnum):
    """State of the link, as far as the estimator can tell."""

    STEADY = "steady"
    APP_LIMITED = "app_limited"
    CONGESTED = "congested"
    DRAINING = "draining"
    OUTAGE = "outage"

    @property
    def words(self) -> str:
        """The state as people read it."""
        return "not filled" if self is LinkState.APP_LIMITED else self.value


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkEstimate:
    """Estimate of the link at one tick.

    Parameters
    ----------
    capacity_bytes_per_second : wire bytes the link carries (bytes/s), ≥ 0
    kind, state : source of the capacity, and state of the link
    queue_delay_s : queue before the link now, the longest that pings, bytes or this host show (s)
    queue_allowance_s : delay that one large message explains; only a longer one is a standing queue (s)
    standing_delay_s : shortest queue of the last moments; bursts come and go, and leave it at 0 (s)
    delivery_rate_bytes_per_second : bytes that the peer received over the last 300 ms; without one, those that left
        this host (bytes/s)
    is_resting : True while next to nothing crosses the link
    age_s : time since the newest evidence for the capacity (s)
    evidence : the last change, in words
    packet_overhead_s : t_ovh, link time of a packet beyond its bytes (s)
    cross_traffic_bytes_per_second : of the capacity, what arpd's topics and probes do not explain (bytes/s)
    loss_ratio : share of recent probe packets that never arrived, None while too few were sent to tell
    return_delay_s : one-way delay of the peer's reports above its recent minimum; commands to the robot wait as long.
        None without a peer (s)
    """

    capacity_bytes_per_second: float
    kind: CapacityKind
    state: LinkState
    queue_delay_s: float
    delivery_rate_bytes_per_second: float
    age_s: float
    evidence: str
    queue_allowance_s: float = 0.05
    standing_delay_s: float = 0.0
    cross_traffic_bytes_per_second: float = 0.0
    packet_overhead_s: float = 0.0
    loss_ratio: float | None = None
    return_delay_s: float | None = None
    is_resting: bool = False

    @property
    def available_bytes_per_second(self) -> float:
        """Capacity that cross traffic leaves for arpd's topics (bytes/s)."""
        capacity = self.capacity_bytes_per_second
        return capacity - min(self.cross_traffic_bytes_per_second, MOST_YIELDED * capacity)

    @property
    def available_packet_overhead_s(self) -> float:
        """Packet overhead on a link that has only the available capacity (s)."""
        available = self.available_bytes_per_second
        return self.packet_overhead_s * self.capacity_bytes_per_second / available if available > 0 else 0.0
