"""Estimators to compare arpd's with: an oracle, and two that look at throughput only.

The governor sees delivery rates, outages and queues by the same definitions as with arpd's estimator.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.estimate import parameters
from arpd.model.endpoints import Direction
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.observation import Observation
    from arpd.model.probing import PeerReport, ProbeRequest
    from arpd.model.settings import LinkSettings

_FIRST_S = 1.0  # reports of this time come before the first plan


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

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:  # noqa: ARG002 - the protocol's
        """Ask for none."""
        return ()

    def reconfigure(self, settings: LinkSettings) -> None:
        """Ignore the settings."""


class _FromThroughput:
    """Base of both estimators: takes delivery rates from the peer's reports, and silence as an outage.

    They see no queue, and cannot tell a link that is full from a robot that sends no more.
    """

    def __init__(self, settings: LinkSettings) -> None:
        self._capacity = settings.initial_capacity_bytes_per_second
        self._reports: deque[PeerReport] = deque()
        self._first_at_s = math.inf
        self._last_at_s = -math.inf

    @property
    def has_evidence(self) -> bool:
        """True after a second of reports."""
        return self._last_at_s - self._first_at_s >= _FIRST_S

    def update(self, observation: Observation) -> LinkEstimate:
        """Return the estimate after the new reports."""
        for report in observation.reports:
            self._note(report)
        silent_s = observation.now_s - self._last_at_s
        return LinkEstimate(
            capacity_bytes_per_second=max(1.0, self._capacity),
            kind=CapacityKind.PEER,
            state=LinkState.OUTAGE if parameters.OUTAGE_S < silent_s < math.inf else LinkState.STEADY,
            queue_delay_s=0.0,
            delivery_rate_bytes_per_second=self._delivery_rate,
            age_s=silent_s,
            evidence="throughput",
        )

    def needs_look(self, now_s: float, backlog_bytes: int | None) -> bool:  # noqa: ARG002 - the protocol's
        """Look always."""
        return True

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:  # noqa: ARG002 - the protocol's
        """Ask for none."""
        return ()

    def reconfigure(self, settings: LinkSettings) -> None:
        """Ignore the settings."""

    @property
    def _delivery_rate(self) -> float:
        covered_s = sum(report.interval_s for report in self._reports)
        return sum(report.rx_bytes for report in self._reports) / covered_s if covered_s > 0 else 0.0

    def _note(self, report: PeerReport) -> None:
        if report.received_at_s - self._last_at_s > parameters.OUTAGE_S:
            self._reports.clear()  # the lost reports leave a gap
        self._first_at_s = min(self._first_at_s, report.received_at_s)
        self._last_at_s = report.received_at_s
        self._reports.append(report)
        while (
            sum(report.interval_s for report in self._reports) - self._reports[0].interval_s
            >= parameters.DELIVERY_WINDOW_S
        ):
            self._reports.popleft()
        self._learn(report)

    def _learn(self, report: PeerReport) -> None:
        raise NotImplementedError


class ThroughputAverage(_FromThroughput):
    """An exponentially weighted average of arrivals, the first estimate of most adaptive streamers.

    Parameters
    ----------
    settings : settings with the initial capacity
    time_constant_s : time in which the average follows 63 % of a change (s)
    """

    def __init__(self, settings: LinkSettings, *, time_constant_s: float = 1.0) -> None:
        super().__init__(settings)
        self._time_constant_s = time_constant_s
        self._is_first = True

    def _learn(self, report: PeerReport) -> None:
        if report.interval_s <= 0:
            return
        rate = report.rx_bytes / report.interval_s
        weight = 1.0 if self._is_first else -math.expm1(-report.interval_s / self._time_constant_s)
        self._is_first = False
        self._capacity += weight * (rate - self._capacity)


class WindowMaximum(_FromThroughput):
    """The largest delivery rate of a window, the bandwidth filter of BBR.

    Cardwell, Cheng, Gunn, Yeganeh, Jacobson: BBR: Congestion-Based Congestion Control, ACM Queue 14(5), 2016. There,
    BtlBw is the maximum delivery rate over six to ten round trips; Wi-Fi has many more in the 8 s here. BBR's gain
    cycle, which sends faster from time to time, belongs to the controller and not to the filter.

    Parameters
    ----------
    settings : settings with the initial capacity
    window_s : length of the window (s)
    """

    def __init__(self, settings: LinkSettings, *, window_s: float = 8.0) -> None:
        super().__init__(settings)
        self._window_s = window_s
        self._rates: deque[tuple[float, float]] = deque()  # falling; the first is the maximum

    def _learn(self, report: PeerReport) -> None:
        now_s, rate = report.received_at_s, self._delivery_rate
        while self._rates and self._rates[-1][1] <= rate:
            self._rates.pop()
        self._rates.append((now_s, rate))
        while now_s - self._rates[0][0] > self._window_s:
            self._rates.popleft()
        self._capacity = self._rates[0][1]
