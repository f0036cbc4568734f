"""Traffic on the link interface that topics, probes and reports do not explain, by direction."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from arpd.estimate.probes import REPORT_BYTES
from arpd.model.endpoints import Direction
from arpd.model.wire import ACKNACK_BYTES, acknowledgements_per_sample, wire_size

if TYPE_CHECKING:
    from arpd.model.endpoints import PublisherState
    from arpd.model.observation import Observation

_WINDOW_S = 1.0


class OtherRates(NamedTuple):
    """Rates of other traffic, never below 0 (bytes/s)."""

    transmit: float
    receive: float


class _Moment(NamedTuple):
    now_s: float
    tx_bytes: int
    rx_bytes: int
    probe_bytes: int
    reports: int


class OtherTraffic:
    """Measures the other traffic of the last second; one `update` per whole turn.

    It is DDS discovery, acknowledgements, resends, calls across the link, and all other programs. Samples count with
    the rates that their publishers announced last, so a rate that has just changed is off for a second. `CrossTraffic`
    is careful where this is quick, because the estimate depends on it.
    """

    def __init__(self) -> None:
        self._moments: deque[_Moment] = deque()

    def update(self, observation: Observation, *, probe_bytes: int, reports: int) -> OtherRates | None:
        """Return the rates, None until the interface has been read for a second.

        Parameters
        ----------
        probe_bytes : wire bytes of all probes so far, in one copy
        reports : received so far
        """
        if (counters := observation.counters) is None:
            self._moments.clear()
            return None
        now = _Moment(observation.now_s, counters.tx_bytes, counters.rx_bytes, probe_bytes, reports)
        self._moments.append(now)
        while len(self._moments) > 1 and now.now_s - self._moments[1].now_s >= _WINDOW_S:
            self._moments.popleft()
        before = self._moments[0]
        if (elapsed_s := now.now_s - before.now_s) < _WINDOW_S:
            return None
        copies = max(1, len(observation.peer_ages_s) if observation.peers is None else observation.peers)
        sent = now.tx_bytes - before.tx_bytes - copies * (now.probe_bytes - before.probe_bytes)
        received = now.rx_bytes - before.rx_bytes - REPORT_BYTES * (now.reports - before.reports)
        return OtherRates(
            max(0.0, sent / elapsed_s - _topics_rate(observation, Direction.SENSING)),
            max(0.0, received / elapsed_s - _topics_rate(observation, Direction.ACTUATION)),
        )


def _topics_rate(observation: Observation, direction: Direction) -> float:
    """Return what the samples of all topics put on the link in one direction (bytes/s)."""
    return sum(_wire_rate(publisher) for publisher in observation.publishers if publisher.direction is direction)


def _wire_rate(publisher: PublisherState) -> float:
    """Return what a publisher's samples and heartbeats put on the link; acknowledgements go the other way (bytes/s)."""
    rate_hz = publisher.published_rate_hz
    wire_bytes, _ = wire_size(publisher.payload_bytes, rate_hz=rate_hz)
    return rate_hz * publisher.copies * (wire_bytes - ACKNACK_BYTES * acknowledgements_per_sample(rate_hz))
