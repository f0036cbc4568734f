"""Samples that reach a reader, and the result of one run per topic."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.endpoints import FlowState


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicResult:
    """One topic over one run, from its source to its reader.

    Parameters
    ----------
    source_rate_hz : rate at which the application publishes if nothing blocks it (Hz)
    expected : samples that the application would have published if the middleware had never blocked it
    offered : samples that the application published
    withheld : samples that pacing did not send; they are not lost
    sent : samples written to the link
    received : different samples that reached the reader
    doubled : repeated arrivals
    reordered : samples that arrived after a younger one
    delivered_bytes : payload bytes of the received samples
    latency_p50_s, latency_p99_s, latency_max_s : source stamp to arrival at the reader, None = none arrived (s)
    age_p50_s, age_p99_s : age of the newest sample at the reader, sampled at 20 Hz, None = none arrived (s)
    """

    topic: str
    source_rate_hz: float
    expected: int
    offered: int
    withheld: int
    sent: int
    received: int
    doubled: int
    reordered: int
    delivered_bytes: int
    latency_p50_s: float | None
    latency_p99_s: float | None
    latency_max_s: float | None
    age_p50_s: float | None
    age_p99_s: float | None

    @property
    def stalled_ratio(self) -> float:
        """Share of the samples that the application never published because ``publish()`` blocked it."""
        return max(0.0, 1 - self.offered / self.expected) if self.expected else 0.0

    @property
    def lost(self) -> int:
        """Samples that were sent but never arrived."""
        return max(0, self.sent - self.received)

    @property
    def loss_ratio(self) -> float:
        """Lost over sent."""
        return self.lost / self.sent if self.sent else 0.0

    @property
    def withheld_ratio(self) -> float:
        """Withheld over offered."""
        return self.withheld / self.offered if self.offered else 0.0


def percentile(values: Sequence[float], q: float) -> float | None:
    """Return the nearest-rank percentile, the smallest value with a share ``q`` at or below it; None without values."""
    if not values:
        return None
    ordered = sorted(values)
    rank = max(1, -(-len(ordered) * round(q * 1000) // 1000))
    return ordered[rank - 1]


@dataclass(slots=True)
class Arrivals:
    """Counts of one reader; sequence numbers count the samples that the application published."""

    latencies_s: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    sequences: set[int] = field(default_factory=set)
    doubled: int = 0
    reordered: int = 0
    delivered_bytes: int = 0
    newest_sequence: int = -1
    newest_stamp_s: float = 0.0

    def on_arrival(self, sequence: int, latency_s: float) -> None:
        """Note the latency of a sample on the wire; the middleware may hold it back until older ones arrive."""
        if sequence not in self.sequences:
            self.latencies_s.append(latency_s)

    def on_delivery(self, sequence: int, stamp_s: float, size_bytes: int) -> None:
        """Count a sample that the reader receives."""
        if sequence in self.sequences:
            self.doubled += 1
            return
        self.sequences.add(sequence)
        self.delivered_bytes += size_bytes
        if sequence < self.newest_sequence:
            self.reordered += 1
        else:
            self.newest_sequence, self.newest_stamp_s = sequence, stamp_s

    def on_age(self, now_s: float) -> None:
        """Note the age of the newest sample."""
        if self.newest_sequence >= 0:
            self.ages_s.append(now_s - self.newest_stamp_s)

    def result(self, flow: FlowState, *, topic: str, source_rate_hz: float, expected: int) -> TopicResult:
        """Return the result of a run.

        Parameters
        ----------
        flow : of the publisher
        topic, source_rate_hz, expected : as in `TopicResult`
        """
        return TopicResult(
            topic=topic,
            source_rate_hz=source_rate_hz,
            expected=expected,
            offered=flow.offered,
            withheld=flow.withheld,
            sent=flow.published,
            received=len(self.sequences),
            doubled=self.doubled,
            reordered=self.reordered,
            delivered_bytes=self.delivered_bytes,
            latency_p50_s=percentile(self.latencies_s, 0.5),
            latency_p99_s=percentile(self.latencies_s, 0.99),
            latency_max_s=max(self.latencies_s, default=None),
            age_p50_s=percentile(self.ages_s, 0.5),
            age_p99_s=percentile(self.ages_s, 0.99),
        )
