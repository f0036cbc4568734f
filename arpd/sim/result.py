"""Result of one run per topic, with the same figures for real and for virtual links."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class Reception:
    """Samples of one topic at one reader.

    Parameters
    ----------
    received : different samples that reached the reader
    doubled : repeated arrivals
    reordered : samples that arrived after a younger one
    delivered_bytes : payload bytes of the received samples
    latency_p50_s, latency_p99_s, latency_max_s : source stamp to arrival at the reader, None = none arrived (s)
    age_p50_s, age_p99_s : age of the newest sample at the reader, sampled at 20 Hz, None = none arrived (s)
    """

    received: int
    doubled: int
    reordered: int
    delivered_bytes: int
    latency_p50_s: float | None
    latency_p99_s: float | None
    latency_max_s: float | None
    age_p50_s: float | None
    age_p99_s: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicResult(Reception):
    """One topic over one run, from its source to its reader.

    Parameters
    ----------
    source_rate_hz : rate at which the application publishes if nothing blocks it (Hz)
    expected : samples that the application would have published if the middleware had never blocked it
    offered : samples that the application published
    withheld : samples that pacing did not send; they are not lost
    sent : samples written to the link
    """

    topic: str
    source_rate_hz: float
    expected: int
    offered: int
    withheld: int
    sent: int

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
