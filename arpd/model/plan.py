"""Plans: the QoS of every publisher and reader, and the steps that bring it there."""

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
    min_rate_hz : floor below which the gate does not push the rate (Hz)
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
            raise ValueError(f"rate_hz {self.rate_hz!r} is not a rate")
        if self.depth < 1:
            raise ValueError(f"depth {self.depth} is below 1")
        if self.deadline_ns < 0:
            raise ValueError(f"deadline_ns {self.deadline_ns} is negative")


@dataclass(frozen=True, kw_only=True, slots=True)
class QosPlan:
    """A whole plan: what every managed publisher should run with; ``topics`` maps topic name to its row."""

    generation: int
    topics: Mapping[str, TopicPlan]
    level_bytes_per_second: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Transition:
    """One atomic step towards a plan: all of one node's publishers at once, or all of its readers.

    Parameters
    ----------
    node : fully qualified node name
    generation : plan generation the step belongs to
    topics : topic name → row to set on the publisher there
    readers : topic name → row to set on the reader there; a step has either these or ``topics``
    reason : why, in words
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
    """What one tick decided.

    Parameters
    ----------
    gate : factor in (0, 1] on every paced rate above its floor
    plan : the plan in force after this tick
    level_changed : whether this tick made a new plan
    reason : why the level changed or was held, in words
    refusals : changes wanted but refused, by reason
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
# Whatever number an endpoint claims to have, no plan gets a greater one than this, which every parameter, announcement
# and metric can hold; there they no longer tell plans apart, and all else goes on.
MOST_GENERATION = 2**53


def keeps_its_readers(plan: TopicPlan, requested_deadline_ns: int) -> bool:
    """Whether the offered deadline is no longer than what the most demanding reader requests (0 = none does)."""
    return is_kept(plan.deadline_ns, requested_deadline_ns)


def is_kept(offered_ns: int, requested_ns: int) -> bool:
    """Whether a reader that requests a deadline hears a writer that offers one (ns, 0 = infinite)."""
    return requested_ns == 0 or 0 < offered_ns <= requested_ns
