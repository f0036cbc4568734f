"""Link, interface and observation for tests: each test states only what it is about."""

from __future__ import annotations

from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.observation import MemoryState, Observation

LINK = LinkEstimate(
    capacity_bytes_per_second=1e6,
    kind=CapacityKind.PEER,
    state=LinkState.STEADY,
    queue_delay_s=0.0,
    delivery_rate_bytes_per_second=5e5,
    age_s=0.0,
    evidence="",
)
INTERFACE = LinkCounters(
    interface="w", rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=InterfaceState.UP
)


def observation(now_s: float, **fields) -> Observation:
    """Return an observation of one unmanaged topic, and of ``fields``."""
    nothing = {
        "counters": None,
        "reports": (),
        "publishers": (),
        "memory": MemoryState(total_bytes=1, available_bytes=1),
        "sensing_topics": 1,  # a topic crosses, so the link is not idle
        "actuation_topics": 0,
    }
    return Observation(now_s=now_s, **{**nothing, **fields})
