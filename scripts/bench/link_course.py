"""The course of one run over the link, real or virtual: truth and belief ten times a second."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.adapters.sim.schedule import RateSchedule

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.adapters.sim.result import TopicResult
    from arpd.daemon.scenario import Moment

MBIT = 125_000.0  # bytes/s
SPELL_S = 12.0  # time before the link changes


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """The course of the link.

    Parameters
    ----------
    schedule : rate over time, as `RateSchedule.parse` reads it
    duration_s : time that the sources publish (s)
    outages : spans in which nothing arrives in either direction (s, s)
    """

    name: str
    schedule: str
    duration_s: float
    outages: tuple[tuple[float, float], ...] = ()

    @property
    def rates(self) -> RateSchedule:
        """Rate of the link over time."""
        return RateSchedule.parse(self.schedule)

    @property
    def event_s(self) -> float:
        """Time of the link's first change; 0 without one (s)."""
        changes = [step.start_s for step in self.rates.steps[1:]] + [start_s for start_s, _ in self.outages]
        return min(changes, default=0.0)

    @property
    def changes_s(self) -> tuple[float, ...]:
        """Times of all changes of the link, with its start (s)."""
        steps = [step.start_s for step in self.rates.steps]
        return tuple(sorted([*steps, *(moment_s for outage in self.outages for moment_s in outage)]))


SCENARIOS = (
    Scenario(name="steady 20", schedule="0:20mbit", duration_s=40.0),
    Scenario(name="steady 5", schedule="0:5mbit", duration_s=40.0),
    Scenario(name="20→5", schedule=f"0:20mbit,{SPELL_S:g}:5mbit", duration_s=35.0),
    Scenario(name="5→20", schedule=f"0:5mbit,{SPELL_S:g}:20mbit", duration_s=35.0),
    Scenario(name="outage", schedule="0:20mbit", duration_s=35.0, outages=((SPELL_S, SPELL_S + 5.0),)),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Belief:
    """The state of arpd at one moment.

    Parameters
    ----------
    estimate_bytes_per_second, foreign_bytes_per_second : capacity and cross traffic (bytes/s)
    budget_bytes_per_second : total that the topics may use now (bytes/s)
    level_bytes_per_second : capacity of the plan in force (bytes/s)
    kind, state : of the estimate
    queue_delay_s : as the daemon measures it (s); None in a simulation
    levels_by_cause, swaps : plans and QoS swaps so far
    probe_bytes, report_bytes : cost of measuring so far, both ways (wire bytes)
    """

    estimate_bytes_per_second: float
    foreign_bytes_per_second: float
    budget_bytes_per_second: float
    level_bytes_per_second: float
    kind: str
    state: str
    queue_delay_s: float | None
    generation: int
    levels_by_cause: dict[str, int]
    swaps: int
    probe_bytes: int
    report_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Instant:
    """One tenth of a second.

    Parameters
    ----------
    t_s : time since the sources began to publish (s)
    truth_bytes_per_second : rate of the link, 0 during an outage (bytes/s)
    queue_delay_s : longest queue of this tenth at the robot's end, from its bytes and the rate (s)
    carried_bytes : bytes that have left the robot since the start; in a simulation, that have arrived
    belief : None without arpd, or while it does not answer
    """

    t_s: float
    truth_bytes_per_second: float
    queue_delay_s: float
    carried_bytes: int | None = None
    belief: Belief | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of one scenario.

    Parameters
    ----------
    side : ``real`` or ``virtual``
    is_managed : with arpd
    course : ten instants a second
    topics : what the readers received
    figures : by the names of `link_figures.FIGURES`
    load : load average of the machine at the end
    """

    scenario: str
    side: str
    is_managed: bool
    round: int
    course: tuple[Instant, ...]
    topics: tuple[TopicResult, ...]
    figures: dict[str, float | None]
    load: float


def with_outages(instants: Sequence[Instant], scenario: Scenario) -> tuple[Instant, ...]:
    """Set the truth to 0 in the instants of an outage."""
    return tuple(
        replace(instant, truth_bytes_per_second=0.0)
        if any(start_s <= instant.t_s < end_s for start_s, end_s in scenario.outages)
        else instant
        for instant in instants
    )


def virtual_course(moments: Sequence[Moment], scenario: Scenario) -> tuple[Instant, ...]:
    """Return the course of a simulated run in the form of a real one."""
    levels: dict[str, int] = {}
    instants = []
    for moment in moments:
        for cause in filter(None, moment.cause.split(", ")):
            levels = {**levels, cause: levels.get(cause, 0) + 1}
        belief = None
        if moment.estimate_bytes_per_second is not None:
            assert moment.cross_traffic_bytes_per_second is not None
            assert moment.budget_bytes_per_second is not None
            assert moment.level_bytes_per_second is not None
            belief = Belief(
                estimate_bytes_per_second=moment.estimate_bytes_per_second,
                foreign_bytes_per_second=moment.cross_traffic_bytes_per_second,
                budget_bytes_per_second=moment.budget_bytes_per_second,
                level_bytes_per_second=moment.level_bytes_per_second,
                kind="",
                state=str(moment.state),
                queue_delay_s=None,
                generation=moment.generation,
                levels_by_cause=levels,
                swaps=moment.swaps,
                probe_bytes=moment.probe_bytes,
                report_bytes=moment.report_bytes,
            )
        instants.append(
            Instant(
                t_s=moment.t_s,
                truth_bytes_per_second=moment.truth_bytes_per_second,
                queue_delay_s=moment.queue_delay_s,
                carried_bytes=round(moment.carried_bytes),
                belief=belief,
            )
        )
    return with_outages(instants, scenario)
