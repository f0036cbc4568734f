"""The document of ``/api/v1/status``: the last snapshot as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.interface import InterfaceState, state_of
from arpd.model.settings import OnLost
from arpd.report.conditions import Condition, Severity
from arpd.report.situation import judge
from arpd.report.topic_rows import topic_rows
from arpd.web.api.endpoints import Topic
from arpd.web.api.observed import Counters, Daemons, Graph, Link, Memory, Peer, Relay, Rmw
from arpd.web.api.part import (
    API_VERSION,
    Age,
    Amount,
    Count,
    Counts,
    Event,
    Measured,
    MeasuredRatio,
    Part,
    Ratio,
    Time,
    of,
    with_topics,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from arpd.model.probing import ClockOffset
    from arpd.report.situation import Situation
    from arpd.report.snapshot import Snapshot
    from arpd.report.topic_rows import TopicRow

MOST_EVENTS = 50


def _number_of(values: Any) -> Any:
    return len(values) if isinstance(values, Mapping) else values


def _nested(solves: Mapping[Any, Any]) -> Mapping[str, Any]:
    """Return counts by back end and outcome as counts by outcome, by back end."""
    nested: dict[str, Any] = {}
    for key, count in sorted(solves.items()):
        if isinstance(key, str):
            nested[key] = count
        else:
            nested.setdefault(key[0], {})[key[1]] = count
    return nested


class Finding(Part):
    """What holds: for the verdict the condition that matters most, and faults beside it."""

    condition: Condition
    """What holds, by name."""
    severity: Severity = of("condition.severity")
    """Its weight: error where arpd cannot cope."""
    headline: str = of("condition.headline")
    """A few words that stay the same while the condition does."""
    text: str
    """One sentence, for the verdict: is the link the problem, what did arpd decide, why, and does it help."""
    wrong: bool = of("condition.is_wrong")
    """Whether somebody should look: arpd status exits 1."""


class Price(Part):
    """Price of the link, from which every publisher computes its rate; null while no topic shares the link."""

    share_per_weight: Measured
    """Share of link time that a topic of weight 1 gets; null = as much as it wants."""
    capacity_bytes_per_second: Amount
    """Capacity by which publishers turn bytes into link time (bytes/s)."""
    packet_overhead_seconds: Amount = of("packet_overhead_s")
    """Link time of a packet beyond its bytes (s)."""
    yielding_weight: Amount
    """Topics of less weight have no minimum rate now; those of this weight keep a part of it."""
    kept_floor: Ratio
    """That part, 0 to 1."""


class Plan(Part):
    """The plan in force."""

    generation: Count = of("decision.plan.generation")
    """Number of the plan, which grows with every new plan; 0 = no plan."""
    reason: str = of("decision.reason")
    """Why the last tick changed or kept the plan, in words."""
    refusals: list[str] = of("decision.refusals")
    """Reasons, such as dwell, for which the last tick did not make a plan or swap that is due."""
    topics: Annotated[Count, BeforeValidator(_number_of)] = of("decision.plan.topics")
    """Topics in the plan."""
    publishers: Count = of("managed")
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
    """Result: whether all minimum rates and reserves fit."""
    binding: Binding
    """Constraint to relax first."""
    capacity_bytes_per_second: Measured
    """Budget: what the topics may use now (bytes/s)."""
    degradation: str
    """Minimum rates and reserves that do not fit, in words; empty if all fit."""
    backend: str
    """Back end that answered, such as osqp or closed_form."""
    solve_seconds: Measured = of("solve_s")
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
    solves: Annotated[dict[str, dict[str, Count]], BeforeValidator(_nested)] = of("solves_by_outcome")
    """Solver runs by back end, then by outcome (solved, failed, disagreed)."""
    cross_check_disagreements: Count
    """Answers of the back end that missed the budget; the closed form answered instead."""
    levels: Counts = of("plans_by_cause")
    """Plans made, by cause."""
    refusals: Counts = of("refusals_by_reason")
    """Plan changes that were wanted but not made, by reason."""
    applies: Counts = of("applies_by_result")
    """Plans sent to nodes, by result."""
    probes: Count
    """Trains and pings sent over the link."""
    probe_bytes: Count
    """Wire bytes of the probes."""
    reports: Count
    """Peer reports received."""
    reloads: Counts = of("reloads_by_result")
    """Configuration reloads by result."""
    events: Counts = of("events_by_kind")
    """Lines of the decision log by event."""


class Config(Part):
    """The configuration in force."""

    path: str = of("config_path")
    """File of the configuration."""
    error: str = of("config_error")
    """Why the last reload was refused; empty if it was not."""


class Status(Part):
    """The answer of GET /api/v1/status: the daemon after its last finished tick.

    Within v1 new keys may come and none goes, so a reader must ignore unknown keys. Before the first tick the answer is
    503 with api_version and ready only. SI base units, named by the key's ending.
    """

    api_version: Literal["v1"] = API_VERSION
    """Version of this document; other versions may lack keys."""
    version: str = of("snapshot.version")
    """Version of arpd."""
    ready: bool = of("is_ready")
    """True while the daemon governs."""
    unix_time_seconds: Time = of("snapshot.unix_time_s")
    """Wall clock at the end of the tick (Unix time, s)."""
    age_seconds: Age = of("age_s")
    """Time since the end of the tick, by the daemon's own clock (s)."""
    tick_seconds: Measured = of("snapshot.tick_s")
    """Duration of the tick (s)."""
    verdict: Finding = of("situation.verdict")
    """The condition of link and plan that matters most."""
    faults: list[Finding] = of("situation.faults")
    """Faults beside the verdict, of ticks, configuration, relay, publishers and peers, the worst first."""
    interface: str = of("snapshot.interface")
    """Current name of the link interface."""
    interface_state: InterfaceState
    """State of the interface."""
    interface_counters: Counters | None = of("snapshot.observation.counters")
    link: Link = of("snapshot")
    peers: list[Peer]
    """Peers heard in the last minute."""
    memory: Memory = of("snapshot.observation.memory")
    graph: Graph = of("snapshot.observation")
    rmw: Rmw | None
    daemons: Daemons = of("snapshot.observation")
    relay: Relay | None = of("snapshot.observation.relay")
    gate: MeasuredRatio = of("snapshot.decision.gate")
    """Part of the traffic above the minimum rates that the link's budget allows, 0 to 1; 1 while no topic is slowed."""
    price: Price | None = of("snapshot.decision.price")
    level_bytes_per_second: Measured = of("snapshot.decision.plan.level_bytes_per_second")
    """Lasting budget that the plan in force was made for (bytes/s on the wire)."""
    plan: Plan = of("snapshot")
    allocation: Allocation = of("snapshot.allocation")
    lease: Lease
    topics: list[Topic] = Field(default=[])
    """Publishers that have announced themselves, sorted by topic and node."""
    totals: Totals = of("snapshot.totals")
    events: Annotated[list[Event], Field(max_length=MOST_EVENTS)]
    """The last lines of the decision log, oldest first."""
    config: Config = of("snapshot")


class _Heard(NamedTuple):
    peer: str
    report_age_seconds: float
    clock: ClockOffset | None


@dataclass(frozen=True, kw_only=True)
class _View:
    """A snapshot as the document shows it."""

    snapshot: Snapshot
    rows: Sequence[TopicRow]
    situation: Situation
    is_ready: bool
    age_s: float | None

    @property
    def interface_state(self) -> InterfaceState:
        return state_of(self.snapshot.observation.counters)

    @property
    def peers(self) -> list[_Heard]:
        observation = self.snapshot.observation
        ages_s = sorted(observation.peer_ages_s.items())
        return [_Heard(peer, age_s, observation.peer_clocks.get(peer)) for peer, age_s in ages_s]

    @property
    def rmw(self) -> Any:
        return self.snapshot.observation if self.snapshot.observation.rmw else None

    @property
    def lease(self) -> Lease:
        lease_s = self.snapshot.lease_s
        return Lease(on_lost=OnLost.BASELINE if lease_s else OnLost.KEEP, after_seconds=lease_s or None)

    @property
    def events(self) -> Any:
        return self.snapshot.events[-MOST_EVENTS:]


def status_json(snapshot: Snapshot, *, is_ready: bool = True, now_s: float | None = None) -> Iterator[bytes]:
    """Yield the whole snapshot as a JSON document, the topics one by one, because each takes a while.

    Parameters
    ----------
    is_ready : True while the daemon governs
    now_s : monotonic clock (s), for the age of the snapshot; with None the age is null
    """
    rows = topic_rows(snapshot)
    view = _View(
        snapshot=snapshot,
        rows=rows,
        situation=judge(snapshot, rows=rows, now_s=now_s),
        is_ready=is_ready,
        age_s=None if now_s is None else max(0.0, now_s - snapshot.finished_at_s),
    )
    yield from with_topics(Status.model_validate(view), (Topic.model_validate(row) for row in rows))
