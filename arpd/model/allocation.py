"""Demand of the topics, and the answer of the program."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Binding(StrEnum):
    """The constraint that stopped a rate or a depth from being larger."""

    LINK = "link"
    MEMORY = "memory"
    LATENCY_BUDGET = "latency_budget"
    DESIRED_RATE = "desired_rate"
    MAX_DEPTH = "max_depth"
    FLOOR = "floor"
    NOTHING = "nothing"


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Demand of one managed topic: one row of the program (docs/design.md, The program).

    Parameters
    ----------
    name : topic name, the row's identity
    wire_bytes : s_i > 0, bytes on the wire per message, headers and unicast copies included (bytes)
    packets : k_i, packets on the wire per message
    desired_rate_hz : u_i, the rate beyond which more is of no use (Hz)
    min_rate_hz : the floor ℓ_i, kept as long as the link carries all floors (Hz)
    weight : w_i > 0; a topic of weight 2 gets twice the link time of one with 1
    min_depth, max_depth : Dmin and Dmax (samples)
    latency_budget_s : cap on depth / rate (s); None = no cap
    slot_bytes : m_i, memory per history slot (bytes)
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
    """The program's answer for one topic; real-valued optimum beside what is applied.

    Parameters
    ----------
    share : e_i, the share of link time (dimensionless)
    max_rate_hz : Rmax_i = 1 / a_i, the rate with the link to itself (Hz)
    rate_hz, depth : the real optimum R*, D*
    deadline_ns, depth_applied : after rounding, feasible in exact arithmetic (ns, samples)
    binding : what stopped the rate; ``depth_binding`` : what stopped the depth
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
    """Whether all of the program's constraints could be kept."""

    OPTIMAL = "optimal"
    DEGRADED = "degraded"  # infeasible as asked; floors or reserves were given up in order
    EMPTY = "empty"  # no topic to plan for


@dataclass(frozen=True, kw_only=True, slots=True)
class Allocation:
    """The program's answer for all topics.

    Parameters
    ----------
    topics : one row per topic, in the order asked
    status : whether everything asked for could be kept
    binding : the binding constraint in all
    capacity_bytes_per_second : the capacity it was solved for, after headroom and foreign traffic (bytes/s)
    degradation : which reserves were given up, in words, empty if none
    backend : back end that answered
    solve_s : time it took (s)
    """

    topics: tuple[TopicAllocation, ...]
    status: AllocationStatus
    binding: Binding
    capacity_bytes_per_second: float
    degradation: str = ""
    backend: str = "exact"
    solve_s: float = 0.0
