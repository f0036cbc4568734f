"""The frozen values every stage of a tick takes and returns; base SI units, units in names."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.observe.rate_limits import Taken

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.interface import LinkCounters
    from arpd.model.probing import PeerReport
    from arpd.model.publishers import PublisherState
    from arpd.model.readers import ReaderPlan, ReaderState

NANOSECONDS_PER_SECOND = 1_000_000_000

# A flow that adapts, as TCP does, takes whatever it is left: yielding all of it would push the robot down to its floors
# step by step. Half is what two equal flows would share.
MOST_YIELDED = 0.5


class Direction(StrEnum):
    """Which way a topic crosses the link."""

    SENSING = "sensing"  # robot computer -> CEDDP (the paper's SPt)
    ACTUATION = "actuation"  # CEDDP -> robot computer (the paper's PAAt)
    LOCAL = "local"  # does not cross the link (no reader on the other host)


class CapacityKind(StrEnum):
    """How the capacity estimate was made, best evidence first."""

    PEER = "peer"
    LOCAL = "local"
    RADIO = "radio"
    CONFIGURED = "configured"


class LinkState(StrEnum):
    """What the link is doing, as far as the estimator can tell."""

    STEADY = "steady"
    APP_LIMITED = "app_limited"
    CONGESTED = "congested"
    DRAINING = "draining"
    OUTAGE = "outage"


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
class MemoryState:
    """Memory of the robot computer (psutil ``virtual_memory``)."""

    total_bytes: int
    available_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """Everything one tick sees of the world.

    Parameters
    ----------
    now_s : monotonic clock (s)
    counters : the robot's link interface, None while it cannot be read
    reports : peer reports that arrived since the last tick, oldest first
    publishers : live AdaptivePublishers
    readers : live AdaptiveSubscriptions
    memory : memory of the robot computer
    sensing_topics, actuation_topics : topics in the graph that cross the link, managed by arpd or not
    peers : peers in the graph, None = not known; with none left, silence is no outage
    rmw : the middleware ROS runs on, empty where there is none
    rmw_refusal : why its publishers are paced and gated only, empty when QoS swaps are on
    other_daemons : hosts of the other daemons in the ROS domain
    superior : host of the one that drives the robot in this one's place, empty when this one does
    radio_bytes_per_second : bit rate the radio transmits at, None where there is no radio or it does not tell (bytes/s)
    peer_ages_s : peers heard in the last minute, with the time since the last report of each (s)
    taken : what became of what arrived from the network
    """

    now_s: float
    counters: LinkCounters | None
    reports: tuple[PeerReport, ...]
    publishers: tuple[PublisherState, ...]
    memory: MemoryState
    sensing_topics: int
    actuation_topics: int
    peers: int | None = None
    readers: tuple[ReaderState, ...] = ()
    rmw: str = ""
    rmw_refusal: str = ""
    other_daemons: tuple[str, ...] = ()
    superior: str = ""
    radio_bytes_per_second: float | None = None
    peer_ages_s: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    taken: Taken = field(default_factory=Taken)


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkEstimate:
    """What the estimator believes of the link.

    Parameters
    ----------
    capacity_bytes_per_second : wire bytes the link carries (bytes/s), ≥ 0
    kind : how it was made
    state : what the link is doing
    queue_delay_s : one-way delay above its 10 s minimum (s)
    queue_allowance_s : delay that does not mean a standing queue: one large message passing explains it (s)
    delivery_rate_bytes_per_second : what the peer received over the last 300 ms (bytes/s)
    age_s : time since the evidence behind the capacity (s)
    evidence : the last change, in words
    packet_overhead_s : t_ovh, link time each packet costs beyond its bytes (s)
    foreign_bytes_per_second : what the link carries that arpd's topics and probes do not explain (bytes/s)
    loss_ratio : share of the probe packets of late that never arrived, None while too few were sent to tell
    return_delay_s : one-way delay of the peer's reports above its minimum of late: what a command to the robot waits,
        None without a peer (s)
    events_by_kind : how often each rule changed the estimate, or an outage began, since the start
    """

    capacity_bytes_per_second: float
    kind: CapacityKind
    state: LinkState
    queue_delay_s: float
    delivery_rate_bytes_per_second: float
    age_s: float
    evidence: str
    queue_allowance_s: float = 0.05
    foreign_bytes_per_second: float = 0.0
    packet_overhead_s: float = 0.0
    loss_ratio: float | None = None
    return_delay_s: float | None = None
    events_by_kind: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def available_bytes_per_second(self) -> float:
        """What is left of the capacity for arpd's topics (bytes/s)."""
        capacity = self.capacity_bytes_per_second
        return capacity - min(self.foreign_bytes_per_second, MOST_YIELDED * capacity)

    @property
    def available_packet_overhead_s(self) -> float:
        """What a packet costs of the link time that is left, as if all of it were arpd's (s)."""
        available = self.available_bytes_per_second
        return self.packet_overhead_s * self.capacity_bytes_per_second / available if available > 0 else 0.0

    @property
    def is_app_limited(self) -> bool:
        """Whether traffic alone says nothing about capacity now."""
        return self.state is LinkState.APP_LIMITED


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Demand of one managed topic: one row of the program (DESIGN §4).

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
    DEGRADED = "degraded"  # infeasible as asked; floors or reserves were given up in order (DESIGN §4)
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
