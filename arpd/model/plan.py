"""Plans: the QoS of every publisher and reader, and the steps that lead there."""

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
    rate_hz : paced publish rate, ≥ 0, ``inf`` = unpaced (Hz)
    min_rate_hz : floor; the gate does not push the rate below it (Hz)
    deadline_ns : offered DEADLINE period, 0 = infinite (ns)
    depth : KEEP_LAST depth (samples), 1..5000
    """

    rate_hz: float
    min_rate_hz: float
    deadline_ns: int
    depth: int

    def __post_init__(self) -> None:
        """Refuse nonsense at birth."""
        if math.isnan(self.rate_hz) or self.rate_hz < 0:
            raise ValueError(f"rate_hz {self.rate_hz!r} must be a number of at least 0")
        if self.depth < 1:
            raise ValueError(f"depth {self.depth} must be at least 1")
        if self.deadline_ns < 0:
            raise ValueError(f"deadline_ns {self.deadline_ns} must be at least 0")


@dataclass(frozen=True, kw_only=True, slots=True)
class QosPlan:
    """Whole plan for the managed publishers; ``topics`` maps a topic name to its row."""

    generation: int
    topics: Mapping[str, TopicPlan]
    level_bytes_per_second: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Transition:
    """One atomic step towards a plan: all publishers of one node at once, or all of its readers.

    Parameters
    ----------
    node : fully qualified node name
    generation : plan generation the step belongs to
    topics : topic name → row to set on its publisher
    readers : topic name → row to set on its reader; a step has either these or ``topics``
    reason : cause of the plan, in words
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    """

    node: str
    generation: int
    topics: Mapping[str, TopicPlan]
    reason: str
    lease_s: float = 0.0
    readers: Mapping[str, ReaderPlan] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, kw_only=True, slots=True)
class Decision:
    """Decision of one tick.

    Parameters
    ----------
    gate : factor in (0, 1] on every paced rate above its floor
    plan : the plan in force after this tick
    level_changed : True when this tick made a new plan
    reason : cause of that plan, empty without one
    refusals : reasons for which a plan that is due was refused
    """

    gate: float
    plan: QosPlan
    level_changed: bool
    reason: str
    refusals: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderPlan:
    """QoS of one reader under a plan: depth (samples) and requested deadline period (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


ReaderPlans = dict[tuple[str, str], ReaderPlan]  # by node and topic
# Endpoints may announce any generation, but no plan gets one above this: every parameter, announcement and metric can
# hold it. At this number generations no longer tell plans apart; everything else continues.
MOST_GENERATION = 2**53


def keeps_its_readers(plan: TopicPlan, requested_deadline_ns: int) -> bool:
    """Return whether the offered deadline is no longer than the tightest that a reader requests (0 = none does)."""
    return is_kept(plan.deadline_ns, requested_deadline_ns)


def is_kept(offered_ns: int, requested_ns: int) -> bool:
    """Return whether a reader that requests a deadline matches a writer that offers one (ns, 0 = infinite)."""
    return requested_ns == 0 or 0 < offered_ns <= requested_ns
