"""A steady link, as its estimate."""

from arpd.model.link import CapacityKind, LinkEstimate, LinkState

LINK = LinkEstimate(
    capacity_bytes_per_second=1e6,
    kind=CapacityKind.PEER,
    state=LinkState.STEADY,
    queue_delay_s=0.0,
    delivery_rate_bytes_per_second=5e5,
    age_s=0.0,
    evidence="",
)
