"""Rows of the program, its answer, and what was decided on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from arpd.model.plan import QosPlan

if TYPE_CHECKING:
    from arpd.model.price import Price


class Binding(StrEnum):
    """Constraint that stops a rate or a depth from being larger."""

    LINK = "link"
    MEMORY = "memory"
    LATENCY_BUDGET = "latency_budget"
    DESIRED_RATE = "desired_rate"
    MAX_DEPTH = "max_depth"
    MINIMUM = "minimum"
    NOTHING = "nothing"


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Row of one managed topic in the program (docs/design.md, The program).

    Parameters
    ----------
    name : topic name, the row's identity
    wire_bytes : s_i > 0, bytes on the wire per message, headers and unicast copies included (bytes)
    packets : k_i, packets on the wire per message
    desired_rate_hz : u_i; a higher rate is of no use (Hz)
    min_rate_hz : the floor ℓ_i ≤ u_i, kept as long as the link carries all floors (Hz)
    weight : w_i > 0; a topic of weight 2 gets twice the link time of one of weight 1
    min_depth, max_depth : Dmin and Dmax (samples)
    latency_budget_s : cap on depth / rate (s); None = no cap
    slot_bytes : m_i > 0, memory per history slot (bytes)
    """

    name: str
    wire_bytes: float
    packets: int
    desired_rate_hz: float
    min_rate_hz: float
    weight: float = 1.0
    min_depth: int = 1
    max_depth: int = 5000
    latency_budget_s: float | None = None
    slot_bytes: float = 1000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicAllocation:
    """Answer of the program for one topic: the real optimum, and the rounded values that are applied.

    Parameters
    ----------
    share : e_i, the share of link time (dimensionless)
    max_rate_hz : Rmax_i = 1 / a_i, the rate with the link to itself (Hz)
    rate_hz, depth : the real optimum R*, D*
    deadline_ns, depth_applied : after rounding, which keeps every constraint (ns, samples)
    binding, depth_binding : what stops the rate, and what stops the depth
    """

    name: str
    share: float
    max_rate_hz: float
    rate_hz: float
    depth: float
    deadline_ns: int
    depth_applied: int
    binding: Binding
    depth_binding: Binding


class AllocationStatus(StrEnum):
    """Success of the program in keeping all constraints."""

    OPTIMAL = "optimal"
    DEGRADED = "degraded"  # infeasible as asked; floors or reserves were given up in order
    EMPTY = "empty"  # no topic to plan for


@dataclass(frozen=True, kw_only=True, slots=True)
class Uniform:
    """What all topics have in common under the uniform policy: Eq. (4) of the paper.

    Parameters
    ----------
    topics : N, the topics that share the link
    max_rate_hz : Rmax, the rate with the divided capacity for one topic alone, of the topics' mean cost (Hz)
    rate_hz, depth : R and D, for each topic alike (Hz, samples)
    """

    topics: int
    max_rate_hz: float
    rate_hz: float
    depth: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Allocation:
    """Answer of the program for all topics.

    Parameters
    ----------
    topics : one answer per topic, in the order of the rows
    status : success in keeping all constraints
    binding : the constraint to relax first
    budget_bytes_per_second : what was divided: the capacity that cross traffic and headroom leave (bytes/s)
    degradation : what was given up, in words; empty if nothing
    price : message that gives every endpoint these rates; None without topics
    uniform : what all topics have in common; None where each has a share of its own
    backend : back end that answered
    solve_s : time the solution took (s)
    """

    topics: tuple[TopicAllocation, ...] = ()
    status: AllocationStatus = AllocationStatus.EMPTY
    binding: Binding = Binding.NOTHING
    budget_bytes_per_second: float = 0.0
    degradation: str = ""
    price: Price | None = None
    uniform: Uniform | None = None
    backend: str = "closed_form"
    solve_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Decision:
    """Decision of one tick.

    Parameters
    ----------
    allowed : part of the traffic above the floors that the price allows, 0..1
    plan : the plan in force after this tick
    reason : cause of a plan that this tick made, empty without one
    is_postponed : True while swaps that are due wait for their part of the link
    """

    allowed: float = 1.0
    plan: QosPlan = field(default_factory=QosPlan)
    reason: str = ""
    is_postponed: bool = False
