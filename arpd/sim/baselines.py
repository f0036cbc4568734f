"""The estimator to compare arpd's with: an oracle.

The governor sees delivery rates, outages and queues by the same definitions as with arpd's estimator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.estimate import parameters
from arpd.model.endpoints import Direction
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.observation import Observation
    from arpd.model.probing import ProbeRequest
    from arpd.model.settings import LinkSettings


@dataclass(frozen=True, kw_only=True, slots=True)
class Truth:
    """True state of a simulated link at one moment.

    Parameters
    ----------
    capacity_bytes_per_second : rate of the link, losses included (bytes/s)
    queue_delay_s : time that a packet sent now would wait on the robot's side (s)
    cross_traffic_bytes_per_second : other traffic over the link (bytes/s)
    packet_overhead_s : link time that a packet costs beyond its bytes when the link is busy (s)
    delivered_bytes_per_second : rate at which the far interface receives (bytes/s)
    loss_ratio : share of packets that the link loses while something arrives
    is_out : True while nothing arrives
    """

    capacity_bytes_per_second: float
    queue_delay_s: float
    cross_traffic_bytes_per_second: float = 0.0
    packet_overhead_s: float = 0.0
    delivered_bytes_per_second: float = 0.0
    loss_ratio: float = 0.0
    is_out: bool = False


class Oracle:
    """A `CapacityEstimator` that knows the link, the upper bound for every estimator; it sends no probes.

    Parameters
    ----------
    truth : returns the true state of the link
    """

    def __init__(self, truth: Callable[[], Truth]) -> None:
        self._truth = truth

    @property
    def has_evidence(self) -> bool:
        """True from the start."""
        return True

    def update(self, observation: Observation) -> LinkEstimate:
        """Return the truth as an estimate."""
        truth = self._truth()
        capacity = max(1.0, truth.capacity_bytes_per_second)
        crossing = [p.payload_bytes for p in observation.publishers if p.direction is not Direction.LOCAL]
        largest_bytes = max(crossing, default=0.0)
        burst_s = min(parameters.BURST_CAP_S, wire_size(largest_bytes, rate_hz=math.inf)[0] / capacity)
        return LinkEstimate(
            capacity_bytes_per_second=capacity,
            kind=CapacityKind.CONFIGURED,
            state=LinkState.OUTAGE if truth.is_out else LinkState.STEADY,
            queue_delay_s=truth.queue_delay_s,
            queue_allowance_s=parameters.QUEUE_LOW_S + burst_s,
            delivery_rate_bytes_per_second=truth.delivered_bytes_per_second,
            age_s=0.0,
            evidence="the truth",
            cross_traffic_bytes_per_second=truth.cross_traffic_bytes_per_second,
            packet_overhead_s=truth.packet_overhead_s,
            loss_ratio=None if truth.is_out else truth.loss_ratio,
        )

    def needs_look(self, now_s: float, backlog_bytes: int | None) -> bool:  # noqa: ARG002 - the protocol's
        """Look always."""
        return True

    def wanted_probes(self, now_s: float, *, is_short: bool) -> tuple[ProbeRequest, ...]:  # noqa: ARG002 - the protocol's
        """Ask for none."""
        return ()

    def reconfigure(self, settings: LinkSettings) -> None:
        """Ignore the settings."""
