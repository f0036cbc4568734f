"""One topic of the robot: what it is, the samples that reach its reader, and its result over one run."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.endpoints import Direction, FlowState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.sim.timeline import Timeline

SAMPLE = struct.Struct("<qd")  # sequence number, source stamp (s)


@dataclass(frozen=True, kw_only=True, slots=True)
class SimTopic:
    """One topic of the robot.

    Parameters
    ----------
    name : the application's name for it
    payload_bytes : serialized size of a sample (bytes)
    rate_hz : rate at which the application publishes (Hz)
    direction : sensing, actuation, or local: its only reader is on the robot
    prefix : the relay carries it as ``prefix + name``; empty if its own publisher is adaptive
    """

    name: str
    payload_bytes: int
    rate_hz: float
    direction: Direction = Direction.SENSING
    prefix: str = ""


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


class Arrivals:
    """Counts of one reader; sequence numbers count the samples that the application published.

    Parameters
    ----------
    topic : whose samples it counts, each of which begins with `SAMPLE`
    """

    def __init__(self, timeline: Timeline, topic: SimTopic) -> None:
        self._timeline, self._topic = timeline, topic
        self._latencies_s: list[float] = []
        self._ages_s: list[float] = []
        self.sequences: set[int] = set()
        self.doubled = self.reordered = 0
        self._newest: tuple[int, float] | None = None  # sequence, stamp s

    @property
    def delivered_bytes(self) -> int:
        """Payload of the samples that were received."""
        return len(self.sequences) * self._topic.payload_bytes

    def on_arrival(self, sample: bytes) -> None:
        """Note the latency of a sample on the wire; the middleware may hold it back until older ones arrive."""
        sequence, stamp_s = SAMPLE.unpack_from(sample)
        if sequence not in self.sequences:
            self._latencies_s.append(self._timeline.now_s - stamp_s)

    def on_delivery(self, sample: bytes) -> None:
        """Count a sample that the reader receives."""
        sequence, stamp_s = SAMPLE.unpack_from(sample)
        if sequence in self.sequences:
            self.doubled += 1
            return
        self.sequences.add(sequence)
        if self._newest is not None and sequence < self._newest[0]:
            self.reordered += 1
        else:
            self._newest = sequence, stamp_s

    def note_age(self) -> None:
        """Note the age of the newest sample now."""
        if self._newest is not None:
            self._ages_s.append(self._timeline.now_s - self._newest[1])

    def result(self, flow: FlowState, *, expected: int) -> TopicResult:
        """Return the result of a run with the flow of the publisher; `TopicResult` explains ``expected``."""
        return TopicResult(
            topic=self._topic.name,
            source_rate_hz=self._topic.rate_hz,
            expected=expected,
            offered=flow.offered,
            withheld=flow.withheld,
            sent=flow.published,
            received=len(self.sequences),
            doubled=self.doubled,
            reordered=self.reordered,
            delivered_bytes=self.delivered_bytes,
            latency_p50_s=percentile(self._latencies_s, 0.5),
            latency_p99_s=percentile(self._latencies_s, 0.99),
            latency_max_s=max(self._latencies_s, default=None),
            age_p50_s=percentile(self._ages_s, 0.5),
            age_p99_s=percentile(self._ages_s, 0.99),
        )
