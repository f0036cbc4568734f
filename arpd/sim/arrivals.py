"""Counts the samples that reach one reader, alike on a real and on a virtual link."""

from __future__ import annotations

from dataclasses import dataclass, field

from arpd.sim.result import Reception, percentile


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

    def reception(self) -> Reception:
        """Return the counts of the run."""
        return Reception(
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
