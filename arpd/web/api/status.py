"""The document of ``/api/v1/status``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.interface import InterfaceState
from arpd.model.link import CapacityKind, LinkState
from arpd.model.settings import OnLost
from arpd.report.events import Severity
from arpd.report.situation import Condition
from arpd.report.status import MOST_EVENTS
from arpd.web.api.endpoints import Topic
from arpd.web.api.part import Amount, Count, Event, Part, Ratio


class Finding(Part):
    """What holds: for the verdict the condition that matters most, and faults beside it."""

    condition: Condition
    """What holds, by name."""
    severity: Severity
    """Its weight: error where arpd cannot cope."""
    headline: str
    """A few words that stay the same while the condition does."""
    text: str
    """One sentence, for the verdict: is the link the problem, what did arpd decide, why, and does it help."""
    wrong: bool
    """Whether somebody should look: arpd status exits 1."""


class Counters(Part):
    """Counters of the interface, which never fall while the daemon runs; null while it is gone."""

    interface: str
    """Name of the interface."""
    up: bool
    """State of the interface."""
    receive_bytes: Count
    """Bytes received."""
    transmit_bytes: Count
    """Bytes sent."""
    receive_packets: Count
    """Packets received."""
    transmit_packets: Count
    """Packets sent."""
    transmit_dropped_packets: Count
    """Packets dropped on the way out."""
    backlog_bytes: Count | None
    """Bytes that wait in the interface's queue; null if the kernel does not tell."""


class Link(Part):
    """Estimate of the link."""

    capacity_bytes_per_second: Amount | None
    """Capacity of the whole link (bytes/s on the wire)."""
    foreign_bytes_per_second: Amount | None
    """Cross traffic, which arpd's topics and probes do not explain (bytes/s on the wire)."""
    available_bytes_per_second: Amount | None
    """Capacity left for arpd's topics (bytes/s on the wire)."""
    kind: CapacityKind
    """Evidence behind the capacity, best first."""
    state: LinkState
    """State of the link; app_limited means that the traffic does not fill it."""
    app_limited: bool
    """True while the traffic is too small to show the capacity."""
    queue_delay_seconds: Amount | None
    """One-way delay from robot to peer above its recent minimum (s)."""
    delivery_rate_bytes_per_second: Amount | None
    """Rate at which the peer received bytes recently (bytes/s on the wire)."""
    packet_overhead_seconds: Amount | None
    """Link time that each packet costs beyond its bytes (s)."""
    loss_ratio: Ratio | None
    """Share of recent probe packets that never arrived, 0 to 1; null if too few were sent."""
    return_delay_seconds: Amount | None
    """Delay of the peer's reports above its recent minimum, which commands wait, too (s); null without a peer."""
    radio_bytes_per_second: Amount | None
    """Bit rate at which the radio transmits (bytes/s); null without a radio or its answer."""
    age_seconds: Amount | None
    """Time since the evidence behind the capacity (s)."""
    evidence: str
    """Reason of the last change of the estimate, in words."""
    events: dict[str, Count]
    """Changes of the estimate by rule, and outages, since the start."""


class Peer(Part):
    """One peer."""

    peer: str
    """Name of the peer."""
    report_age_seconds: Amount | None
    """Time since the peer's last report (s)."""
    clock_offset_seconds: float | None
    """The peer's clock less this host's (s), above 0 ahead; null if no probe of the last 30 s was answered."""
    clock_uncertainty_seconds: Amount | None
    """Most error of clock_offset_seconds (s): half the shortest round trip of the last 30 s."""


class Memory(Part):
    """Memory of the robot computer."""

    total_bytes: Count
    """Total memory (bytes)."""
    available_bytes: Count
    """Memory available without swapping (bytes)."""


class Graph(Part):
    """Topics in the ROS graph that cross the link, managed by arpd or not."""

    sensing_topics: Count
    """Topics from the robot."""
    actuation_topics: Count
    """Topics to the robot."""


class Rmw(Part):
    """Middleware of ROS; null without ROS."""

    name: str
    """RMW identifier of the middleware."""
    swaps: bool
    """True if arpd can swap writers on this middleware."""
    refusal: str
    """Why arpd only paces publishers; empty if it can swap writers."""


class Daemons(Part):
    """Other arpd daemons in the ROS domain."""

    others: list[str]
    """Hosts of the other daemons."""
    standing_by_for: str
    """Host of the active daemon while this one stands by; empty if this one is active."""


class RelayDirection(Part):
    """Topics of one direction."""

    offered: Count
    """Topics that the one side may send."""
    wanted: Count
    """Those that the other side reads."""
    refused: dict[str, str]
    """Topics and services that an end refuses to carry, with the reason; at most a hundred."""


class Relay(Part):
    """Relay with two ends, as its end on the robot tells it; null without one, and while that end is silent."""

    other_host: str
    """Host of the end on the base computer; empty while it was never heard."""
    fault: str
    """Why that end's messages are not understood; empty if they are."""
    to_base: RelayDirection
    """Topics from the robot to the base computer."""
    to_robot: RelayDirection
    """Topics from the base computer to the robot."""
    received: Count
    """Samples that the robot's end received and wrote."""
    doubled: Count
    """Samples that it received a second time."""
    unknown: Count
    """Samples of writers that it does not know."""
    outdated: Count
    """Samples that an outage delayed until a newer one of their source had come."""
    link_bytes: Count
    """What both ends' chunks took of the link, headers and acknowledgements included."""
    incomplete: Count
    """Samples of groups that it dropped, because their set was never complete."""
    calls_failed: dict[str, Count]
    """Calls from the robot's nodes that had no answer, by reason."""
    strangers: list[str]
    """Nodes in the link domain that are not arpd's; the first three."""
    types_differ: dict[str, str]
    """Topics whose type differs between the sides, with both types."""
    reachable: bool
    """True if the end on the base computer spoke in the last 3.5 s."""


class Price(Part):
    """Price of the link, from which every publisher computes its rate; null while no topic shares the link."""

    share_per_weight: Amount | None
    """Share of link time that a topic of weight 1 gets; null = as much as it wants."""
    capacity_bytes_per_second: Amount
    """Capacity by which publishers turn bytes into link time (bytes/s)."""
    packet_overhead_seconds: Amount
    """Link time of a packet beyond its bytes (s)."""
    yielding_weight: Amount
    """Topics of less weight have no floor now; those of this weight keep a part of it."""
    kept_floor: Ratio
    """That part, 0 to 1."""


class Plan(Part):
    """The plan in force."""

    generation: Count
    """Number of the plan, which grows with every new plan; 0 = no plan."""
    reason: str
    """Why the last tick changed or kept the plan, in words."""
    refusals: list[str]
    """Reasons, such as dwell, for which the last tick did not make a plan or swap that is due."""
    topics: Count
    """Topics in the plan."""
    publishers: Count
    """Live publishers of the plan."""
    confirmed: Count
    """Publishers whose announcement matches the plan."""
    paced_only: Count
    """Publishers of the plan that refuse new QoS for good."""


class Uniform(Part):
    """Eq. (4) for all topics; null unless program.policy is uniform and there is a topic to plan for."""

    topics: Annotated[int, Field(ge=1)]
    """N, the topics that share the link."""
    max_rate_hz: Amount
    """Rmax, the rate with the divided capacity for one topic alone (Hz)."""
    rate_hz: Amount
    """R, the rate of each topic (Hz)."""
    depth: Annotated[int, Field(ge=1)]
    """D, the depth of each topic (samples)."""


class Allocation(Part):
    """The program's answer in the last tick."""

    status: AllocationStatus
    """Result: whether all floors and reserves fit."""
    binding: Binding
    """Constraint to relax first."""
    capacity_bytes_per_second: Amount | None
    """Budget: what the topics may use now (bytes/s)."""
    degradation: str
    """Floors and reserves that do not fit, in words; empty if all fit."""
    backend: str
    """Back end that answered, such as osqp or closed_form."""
    solve_seconds: Amount | None
    """Duration of the solve (s)."""
    uniform: Uniform | None


class Lease(Part):
    """Fate of the plan if publishers lose the daemon."""

    on_lost: OnLost
    """keep: the plan stays; baseline: publishers return to their own QoS."""
    after_seconds: Amount | None
    """Silence after which this happens (s); null = never."""


class Totals(Part):
    """Counts of the daemon since its start."""

    ticks: Count
    """Finished ticks."""
    ticks_failed: Count
    """Ticks that raised an error."""
    ticks_late: Count
    """Ticks that began more than half a period late."""
    solves: dict[str, dict[str, Count]]
    """Solver runs by back end, then by outcome (solved, failed, disagreed)."""
    cross_check_disagreements: Count
    """Answers of the back end that missed the budget; the closed form answered instead."""
    levels: dict[str, Count]
    """Plans made, by cause."""
    refusals: dict[str, Count]
    """Plan changes that were wanted but not made, by reason."""
    applies: dict[str, Count]
    """Plans sent to nodes, by result."""
    probes: Count
    """Trains and pings sent over the link."""
    probe_bytes: Count
    """Wire bytes of the probes."""
    reports: Count
    """Peer reports received."""
    reloads: dict[str, Count]
    """Configuration reloads by result."""
    events: dict[str, Count]
    """Lines of the decision log by event."""


class Config(Part):
    """The configuration in force."""

    path: str
    """File of the configuration."""
    error: str
    """Why the last reload was refused; empty if it was not."""


class Status(Part):
    """The answer of GET /api/v1/status: the daemon after its last finished tick.

    Within v1 new keys may come and none goes, so a reader must ignore unknown keys. Before the first tick the answer is
    503 with api_version and ready only. SI base units, named by the key's ending.
    """

    api_version: Literal["v1"]
    """Version of this document; other versions may lack keys."""
    version: str
    """Version of arpd."""
    ready: bool
    """True while the daemon governs."""
    unix_time_seconds: float
    """Wall clock at the end of the tick (Unix time, s)."""
    age_seconds: Amount | None
    """Time since the end of the tick, by the daemon's own clock (s)."""
    tick_seconds: float | None
    """Duration of the tick (s)."""
    verdict: Finding
    """The condition of link and plan that matters most."""
    faults: list[Finding]
    """Faults beside the verdict, of ticks, configuration, relay, publishers and peers, the worst first."""
    interface: str
    """Current name of the link interface."""
    interface_state: InterfaceState
    """State of the interface."""
    interface_counters: Counters | None
    link: Link
    peers: list[Peer]
    """Peers heard in the last minute."""
    memory: Memory
    graph: Graph
    rmw: Rmw | None
    daemons: Daemons
    relay: Relay | None
    gate: Ratio | None
    """Part of the traffic above the floors that the link's budget admits, 0 to 1; 1 while no topic is slowed."""
    price: Price | None
    level_bytes_per_second: Amount | None
    """Lasting budget that the plan in force was made for (bytes/s on the wire)."""
    plan: Plan
    allocation: Allocation
    lease: Lease
    topics: list[Topic]
    """Publishers that have announced themselves, sorted by topic and node."""
    totals: Totals
    events: Annotated[list[Event], Field(max_length=MOST_EVENTS)]
    """The last lines of the decision log, oldest first."""
    config: Config
