"""The documents of the API, as dataclasses: the daemon writes them as JSON, `arpd status` and `arpd top` read them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from arpd.model.allocation import Allocation, TopicAllocation
from arpd.model.endpoints import PublisherState
from arpd.model.interface import InterfaceState, LinkCounters, state_of
from arpd.model.link import LinkEstimate
from arpd.model.observation import MemoryState, Surroundings
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.probing import ClockOffset
from arpd.model.relay import RelaySummary
from arpd.report.conditions import Condition, Event, Happening, Severity
from arpd.report.history import LINK_SERIES, PERIOD_S, SPAN_S, Sample
from arpd.report.situation import judge
from arpd.report.snapshot import Snapshot, Totals
from arpd.report.topic_rows import Topic, topic_rows
from arpd.web.json_text import plain, text

if TYPE_CHECKING:
    from arpd.report import conditions

API_VERSION = "v1"
# `Event`, `Topic` and `Surroundings` name them for type checkers only; who reads a document finds them here.
NESTED = (Happening, MemoryState, PublisherState, RelaySummary, TopicAllocation, TopicPlan)
_MOST_EVENTS = 50


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """What holds: for the verdict the condition that matters most, and faults beside it.

    Parameters
    ----------
    condition, severity : what holds, by name, and its weight
    headline : a few words that stay the same while the condition does
    text : one sentence: is the link the problem, what did arpd decide, why, and does it help
    wrong : whether somebody should look: `arpd status` exits 1
    """

    condition: Condition
    severity: Severity
    headline: str
    text: str
    wrong: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Peer:
    """A peer heard in the last minute.

    Parameters
    ----------
    report_age_s : time since its last report (s)
    clock : its clock against this host's; null if no probe of the last 30 s was answered
    """

    peer: str
    report_age_s: float
    clock: ClockOffset | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """The plan in force.

    Parameters
    ----------
    generation : grows with every new plan; 0 = no plan
    reason : why the last tick changed the plan; empty if it did not
    level_bytes_per_second : last lasting budget that the plan fitted (bytes/s on the wire)
    topics, publishers : topics in the plan, and their live publishers
    confirmed, paced_only : publishers that announce the plan, and those that refuse new QoS for good
    """

    generation: int
    reason: str
    level_bytes_per_second: float
    topics: int
    publishers: int
    confirmed: int
    paced_only: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Status(Surroundings):
    """The answer of GET /api/v1/status: the daemon after its last finished tick.

    Within v1 new keys may come and none goes, so a reader must ignore unknown keys. Before the first tick the answer is
    503 with api_version and ready only. Keys end in their unit; numbers have five digits, and one that may be infinite
    or unknown is null then.

    Parameters
    ----------
    ready : true; false in that answer before the first tick
    unix_time_s, age_s : end of the tick by the wall clock, and the time since, by the daemon's own clock (s)
    tick_s : duration of the tick (s)
    verdict : the condition of link and plan that matters most
    faults : those beside it, of ticks, configuration, relay, publishers and peers, the worst first
    interface, interface_state, interface_counters : the link interface; the counters are null while it is gone
    available_bytes_per_second : capacity left for arpd's topics (bytes/s on the wire)
    budget_bytes_per_second : what the topics may use now (bytes/s on the wire)
    allowed_ratio : part of the traffic above the minimum rates that the budget allows; 1 while no topic is slowed
    price : null while no topic shares the link
    allocation : the program's answer in the last tick
    lease_s : silence of the daemon after which publishers return to their own QoS, 0 = never (s)
    topics : sorted by topic and node
    totals : counts since the start
    events : the last lines of the decision log, oldest first
    config_path, config_error : file of the configuration, and why the last reload was refused; empty if it was not
    """

    api_version: str = API_VERSION
    version: str
    ready: bool
    unix_time_s: float
    age_s: float
    tick_s: float
    verdict: Finding
    faults: tuple[Finding, ...]
    interface: str
    interface_state: InterfaceState
    interface_counters: LinkCounters | None
    link: LinkEstimate
    available_bytes_per_second: float
    budget_bytes_per_second: float
    allowed_ratio: float
    peers: tuple[Peer, ...]
    price: Price | None
    plan: Plan
    allocation: Allocation
    lease_s: float
    totals: Totals
    events: tuple[Event, ...]
    config_path: str
    config_error: str
    topics: tuple[Topic, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class History:
    """The answer of GET /api/v1/history: the last ten minutes, one sample a second, in columns as long as times.

    The oldest sample comes first; null = nothing or unknown. Numbers have five digits. Within v1 new keys may come and
    none goes.

    Parameters
    ----------
    unix_time_s : wall clock of the last sample (Unix time, s); null before the first
    period_s, span_s : time between two samples, except for late ticks, and age up to which they are kept (s)
    times : of each sample (Unix time, s), counted back from the last one, so that they always rise
    states : of the link
    link : numbers of the link, each as in the status
    events : the last lines of the decision log, oldest first
    """

    api_version: str = API_VERSION
    unix_time_s: float | None
    period_s: float = PERIOD_S
    span_s: float = SPAN_S
    times: tuple[float, ...]
    states: tuple[str, ...]
    link: Mapping[str, tuple[float | None, ...]]
    events: tuple[Event, ...]


def status_json(snapshot: Snapshot, *, now_s: float) -> Iterator[bytes]:
    """Yield the whole snapshot as a JSON document, the topics last and one by one, because each takes a while."""
    rows = topic_rows(snapshot)
    judged = judge(snapshot, rows=rows, now_s=now_s)
    observation, link, decision = snapshot.observation, snapshot.link, snapshot.decision
    head = Status(
        version=snapshot.version,
        **{each.name: getattr(observation, each.name) for each in fields(Surroundings)},
        ready=True,
        unix_time_s=snapshot.unix_time_s,
        age_s=max(0.0, now_s - snapshot.finished_at_s),
        tick_s=snapshot.tick_s,
        verdict=_finding(judged.verdict),
        faults=tuple(map(_finding, judged.faults)),
        interface=snapshot.interface,
        interface_state=state_of(observation.counters),
        interface_counters=observation.counters,
        link=link,
        available_bytes_per_second=link.available_bytes_per_second,
        budget_bytes_per_second=snapshot.allocation.budget_bytes_per_second,
        allowed_ratio=decision.allowed,
        peers=tuple(
            Peer(peer=peer, report_age_s=age_s, clock=observation.peer_clocks.get(peer))
            for peer, age_s in sorted(observation.peer_ages_s.items())
        ),
        price=snapshot.allocation.price,
        plan=Plan(
            generation=decision.plan.generation,
            reason=decision.reason,
            level_bytes_per_second=decision.plan.level_bytes_per_second,
            topics=len(decision.plan.topics),
            publishers=snapshot.managed,
            confirmed=snapshot.confirmed,
            paced_only=snapshot.paced_only,
        ),
        allocation=snapshot.allocation,
        lease_s=snapshot.settings.lease_s,
        totals=snapshot.totals,
        events=snapshot.events[-_MOST_EVENTS:],
        config_path=snapshot.config_path,
        config_error=snapshot.config_error,
    )
    parts = plain(head)
    del parts["topics"]
    yield text(parts)[:-1] + b',"topics":['
    for number, row in enumerate(rows):
        yield (b"," if number else b"") + text(plain(row))
    yield b"]}\n"


def _finding(found: conditions.Finding) -> Finding:
    what = found.condition
    return Finding(condition=what, severity=what.severity, headline=what.headline, text=found.text, wrong=what.is_wrong)


def history_json(samples: Sequence[Sample], logged: Sequence[Event]) -> bytes:
    """Return the history as a JSON document, of samples and events of the decision log, each the oldest first."""
    newest = samples[-1] if samples else None
    columns = list(zip(*(sample.link for sample in samples), strict=True)) or [()] * len(LINK_SERIES)
    history = History(
        unix_time_s=newest.unix_time_s if newest else None,
        # Counted back from the newest: somebody may have set the wall clock, and charts need rising times.
        times=tuple(newest.unix_time_s - (newest.at_s - sample.at_s) for sample in samples) if newest else (),
        states=tuple(sample.state for sample in samples),
        link=dict(zip(LINK_SERIES, columns, strict=True)),
        events=tuple(logged),
    )
    return text(plain(history)) + b"\n"
