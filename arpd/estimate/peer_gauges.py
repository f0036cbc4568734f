"""The queue in front of the link, as all peers behind it show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.estimate.peer_queue import QueueGauge

if TYPE_CHECKING:
    from arpd.estimate.parameters import EstimatorTuning
    from arpd.estimate.peer_queue import SentProbe
    from arpd.model.probing import PeerReport


class PeerGauges:
    """One gauge for each peer: what they receive adds up, and the longest queue counts.

    Parameters
    ----------
    tuning : the windows, and the silence after which a peer is forgotten
    """

    def __init__(self, tuning: EstimatorTuning) -> None:
        self._tuning = tuning
        self._gauges: dict[str, QueueGauge] = {}  # by name, the one heard for the longest first

    def __len__(self) -> int:
        return len(self._gauges)

    def digest(self, report: PeerReport, *, handed_bytes: float | None) -> QueueGauge:
        """Note a report, forget who is silent, and return the gauge of who is not.

        Parameters
        ----------
        handed_bytes : what this host's interface has been handed by now (bytes), None = not known
        """
        self._gauges = {
            name: gauge
            for name, gauge in self._gauges.items()
            if report.received_at_s - gauge.reported_s <= self._tuning.outage_forget_s or name == report.peer
        }
        gauge = self._gauges.get(report.peer) or self._gauges.setdefault(report.peer, QueueGauge(self._tuning))
        # With several, the bytes that one did not receive may be another's.
        gauge.digest(report, handed_bytes=handed_bytes if len(self._gauges) == 1 else None)
        return gauge

    def is_first(self, name: str) -> bool:
        """Whether no other peer was heard for longer."""
        return next(iter(self._gauges), "") == name

    def note_sent(self, probe: SentProbe) -> None:
        """Note a probe that leaves; it crosses the link once for each peer."""
        for gauge in self._gauges.values():
            gauge.note_sent(probe)

    def forget(self) -> None:
        """Start anew with every peer: what was measured was of another link, or of another queue."""
        for gauge in self._gauges.values():
            gauge.forget()

    def delay_s(self, now_s: float) -> float:
        """Return what the longest queue delays a ping, or has delayed one by now that has not arrived (s)."""
        return max((max(gauge.delay_s, gauge.overdue_s(now_s)) for gauge in self._gauges.values()), default=0.0)

    def backlog_s(self, now_s: float, *, burst_bytes: float, capacity_bytes_per_second: float) -> float:
        """Return how long what has not arrived will take to arrive; see `QueueGauge.backlog_s` (s)."""
        each = (
            gauge.backlog_s(now_s, burst_bytes=burst_bytes, capacity_bytes_per_second=capacity_bytes_per_second)
            for gauge in self._gauges.values()
        )
        return max(each, default=0.0)

    def is_steady(self, since_s: float) -> bool:
        """Whether what arrived at any of them since then came at one rate: so serves a queue."""
        return any(gauge.is_steady(since_s) for gauge in self._gauges.values())

    def delivery(self, since_s: float) -> tuple[float, float]:
        """Return what all received in the last intervals that began since then: bytes/s and packets/s."""
        each = [gauge.delivery(since_s) for gauge in self._gauges.values()]
        return sum(size for size, _ in each), sum(packets for _, packets in each)

    @property
    def return_delay_s(self) -> float | None:
        """What the longest queue on the way back delays a report; None while none tells (s)."""
        return max((d for gauge in self._gauges.values() if (d := gauge.return_delay_s) is not None), default=None)
