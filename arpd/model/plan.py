"""Plans: the QoS of every publisher."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

NANOSECONDS_PER_SECOND = 1_000_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicPlan:
    """QoS of one publisher under a plan.

    Parameters
    ----------
    rate_hz : ceiling of the paced rate, ≥ 0, ``inf`` = unpaced (Hz)
    min_rate_hz : floor, which the price keeps as long as the link carries all floors (Hz)
    deadline_ns : offered DEADLINE period, 0 = infinite (ns)
    depth : KEEP_LAST depth (samples), 1..5000; 0 = each publisher's application chose depth and deadline
    weight : w, share of link time relative to other topics; 0 = no price applies, the rate is the ceiling
    wire_bytes, packets : s and k, what one sample puts on the link, over all copies
    max_rate_hz : what the configuration allows; a topic may leave faster than ``rate_hz`` after a wait, while its
        source grows, or where the link has time to spare, but no faster than that (Hz)
    """

    rate_hz: float
    min_rate_hz: float
    deadline_ns: int
    depth: int
    weight: float = 0.0
    wire_bytes: float = 0.0
    packets: int = 0
    max_rate_hz: float = math.inf

    def __post_init__(self) -> None:
        if math.isnan(self.rate_hz) or self.rate_hz < 0:
            raise ValueError(f"rate_hz {self.rate_hz!r} must be a number of at least 0")
        if self.depth < 0:
            raise ValueError(f"depth {self.depth} must be at least 0")
        if self.deadline_ns < 0:
            raise ValueError(f"deadline_ns {self.deadline_ns} must be at least 0")

    @property
    def qos(self) -> tuple[int, int]:
        """Depth and deadline, which only a swap changes."""
        return self.depth, self.deadline_ns


def own_qos(rate_hz: float) -> TopicPlan:
    """Return the row that gives each publisher of a topic its application's depth and deadline back."""
    return TopicPlan(rate_hz=rate_hz, min_rate_hz=0.0, deadline_ns=0, depth=0)


@dataclass(frozen=True, kw_only=True, slots=True)
class QosPlan:
    """Whole plan for the managed publishers; ``topics`` maps a topic name to its row.

    ``level_bytes_per_second`` is the last lasting budget that all of its deadlines fitted.
    """

    generation: int = 0
    topics: Mapping[str, TopicPlan] = field(default_factory=lambda: MappingProxyType({}))
    level_bytes_per_second: float = 0.0


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """A node's answer to plans: which one is in force, and which one it refused last, and why.

    Parameters
    ----------
    generation : of the plan in force, 0 = none
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    refused, refusal : generation of the refused plan, and why; empty after a plan was taken
    """

    generation: int = 0
    lease_s: float = 0.0
    refused: int = 0
    refusal: str = ""


NO_PLAN = PlanAnswer()


# Nodes may tell any generation, but no plan gets one above this: every message and metric can hold it. At this number
# generations no longer tell plans apart; everything else continues.
MOST_GENERATION = 2**53


def rate_of(period_ns: int) -> float:
    """Return the rate of a whole period (Hz); 0 for none."""
    return NANOSECONDS_PER_SECOND / period_ns if period_ns else 0.0


def is_kept(offered_ns: int, requested_ns: int) -> bool:
    """Return whether a reader that requests a deadline matches a writer that offers one (ns, 0 = infinite)."""
    return requested_ns == 0 or 0 < offered_ns <= requested_ns
