"""Reading a stamped sample without deserializing it, and keeping the demo's books per topic."""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass, field

from arpd.sim.result import percentile

_HEADER = struct.Struct("<iII")  # std_msgs/Header in CDR: seconds, nanoseconds, length of frame_id
_ENCAPSULATION_BYTES = 4


def read_stamp(sample: bytes) -> tuple[float, int]:
    """Return source stamp (Unix s) and sequence number (``frame#123`` in frame_id) of a serialized stamped message."""
    seconds, nanoseconds, length = _HEADER.unpack_from(sample, _ENCAPSULATION_BYTES)
    start = _ENCAPSULATION_BYTES + _HEADER.size
    frame = sample[start : start + length - 1].decode()
    return seconds + nanoseconds * 1e-9, int(frame.rpartition("#")[2])


@dataclass(slots=True)
class Arrivals:
    """What reached one reader."""

    latencies_s: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    sequences: set[int] = field(default_factory=set)
    doubled: int = 0
    reordered: int = 0
    delivered_bytes: int = 0
    newest_stamp_s: float = 0.0
    newest_sequence: int = -1
    recent: int = 0
    recent_latency_s: float = 0.0

    def on_sample(self, sample: bytes, arrived_s: float) -> None:
        """Note one sample with the moment it left the wire (Unix s)."""
        stamp_s, sequence = read_stamp(sample)
        if sequence in self.sequences:
            self.doubled += 1
            return
        self.sequences.add(sequence)
        if sequence < self.newest_sequence:
            self.reordered += 1
        else:
            self.newest_sequence, self.newest_stamp_s = sequence, stamp_s
        self.latencies_s.append(arrived_s - stamp_s)
        self.delivered_bytes += len(sample)
        self.recent += 1
        self.recent_latency_s = max(self.recent_latency_s, arrived_s - stamp_s)

    def on_age(self, now_s: float) -> None:
        """Sample the age of the newest sample."""
        if self.newest_sequence >= 0:
            self.ages_s.append(now_s - self.newest_stamp_s)

    def take_recent(self) -> tuple[int, float]:
        """Count and worst latency since the last call."""
        recent, self.recent = self.recent, 0
        latency_s, self.recent_latency_s = self.recent_latency_s, 0.0
        return recent, latency_s

    def summary(self) -> Summary:
        """Figures of the whole run."""
        return Summary(
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Summary:
    """What one reader saw of one topic; see `arpd.sim.result.TopicResult`."""

    received: int
    doubled: int
    reordered: int
    delivered_bytes: int
    latency_p50_s: float | None
    latency_p99_s: float | None
    latency_max_s: float | None
    age_p50_s: float | None
    age_p99_s: float | None

    def as_dict(self) -> dict[str, float | int | None]:
        """JSON form."""
        return asdict(self)
