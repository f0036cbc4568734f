"""One scenario run three ways: with arpd, without it, and with an oracle in place of arpd's estimator."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from arpd.daemon.scenario import run
from arpd.model.link import LinkState
from arpd.sim.baselines import Oracle
from arpd.sim.result import percentile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import TypeAlias

    from arpd.daemon.scenario import Moment, ScenarioResult
    from arpd.model.settings import Settings
    from arpd.sim.link import LinkModel
    from arpd.sim.robot import SimTopic
    from arpd.sim.schedule import RateSchedule

    Comparison: TypeAlias = Mapping[str, ScenarioResult]  # by way

WARM_UP_S = 10.0  # until the link is measured and the first plan applied; not part of any summary


@dataclass(frozen=True, kw_only=True, slots=True)
class Summary:
    """Figures of one run over a span of time; None where only arpd has the figure.

    Parameters
    ----------
    goodput_bytes_per_second : payload delivered from the robot (bytes/s)
    carried_share : wire bytes carried from the robot, resends and probes included, as a share of what the link could
    budget_mean_bytes_per_second : mean of the total that the topics might use (bytes/s)
    queue_peak_s, queue_p99_s : longest queue on the robot's side and its 99th percentile, sampled at 10 Hz (s)
    error_median, error_p90 : median and 90th percentile of |estimate / rate of the link - 1|
    plans_per_minute : plans made (1/min)
    swaps_per_minute : writers replaced, all topics together (1/min)
    measuring_share : wire bytes of probes and reports, as a share of what the link could carry
    """

    goodput_bytes_per_second: float
    carried_share: float
    budget_mean_bytes_per_second: float | None
    queue_peak_s: float
    queue_p99_s: float
    error_median: float | None
    error_p90: float | None
    plans_per_minute: float
    swaps_per_minute: float
    measuring_share: float


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkEvent:
    """An event that an operator would see in the log.

    Parameters
    ----------
    t_s : run time (s)
    what : cause of a plan, or new state of the link
    before_bytes_per_second, after_bytes_per_second : level of the plan before and after; None for a state (bytes/s)
    """

    t_s: float
    what: str
    before_bytes_per_second: float | None = None
    after_bytes_per_second: float | None = None


def compare(
    settings: Settings,
    schedule: RateSchedule,
    duration_s: float,
    *,
    seed: int,
    model: LinkModel,
    topics: tuple[SimTopic, ...],
    on_way: Callable[[str], None] = lambda _: None,
) -> Comparison:
    """Run the scenario three times; return the results by way: ``arpd``, ``without`` and ``oracle``.

    Parameters
    ----------
    settings : configuration of arpd, and of the oracle's governor
    schedule, duration_s, seed, model, topics : as in `arpd.daemon.scenario.run`
    on_way : called with the name of each way before it runs
    """
    found: dict[str, ScenarioResult] = {}
    for way in ("arpd", "without", "oracle"):
        on_way(way)
        found[way] = run(
            settings,
            schedule,
            duration_s,
            seed=seed,
            managed=way != "without",
            model=model,
            topics=topics,
            make_estimator=Oracle if way == "oracle" else None,
        )
    return found


def summarize(result: ScenarioResult, *, start_s: float, end_s: float) -> Summary:
    """Summarise the moments of a span.

    Parameters
    ----------
    start_s, end_s : run time, at least a second apart (s)
    """
    span = between(result.moments, start_s, end_s)
    first, last = span[0], span[-1]
    elapsed_s = last.t_s - first.t_s
    queues = [moment.queue_delay_s for moment in span]
    errors = [error for moment in span if (error := estimate_error(moment)) is not None]
    budgets = [budget for moment in span if (budget := moment.budget_bytes_per_second) is not None]
    could = sum(moment.truth_bytes_per_second * (after.t_s - moment.t_s) for moment, after in pairwise(span))
    measuring = last.probe_bytes + last.report_bytes - first.probe_bytes - first.report_bytes
    return Summary(
        goodput_bytes_per_second=(last.delivered_bytes - first.delivered_bytes) / elapsed_s,
        carried_share=(last.carried_bytes - first.carried_bytes) / could if could > 0 else 0.0,
        budget_mean_bytes_per_second=sum(budgets) / len(budgets) if budgets else None,
        queue_peak_s=max(queues),
        queue_p99_s=percentile(queues, 0.99) or 0.0,
        error_median=percentile(errors, 0.5),
        error_p90=percentile(errors, 0.9),
        plans_per_minute=sum(bool(moment.cause) for moment in span) / (end_s - start_s) * 60.0,
        swaps_per_minute=(last.swaps - first.swaps) / elapsed_s * 60.0,
        measuring_share=measuring / could if could > 0 else 0.0,
    )


def estimate_error(moment: Moment) -> float | None:
    """Return |estimate / rate of the link - 1|; None without an estimate, and in an outage."""
    if moment.estimate_bytes_per_second is None or moment.truth_bytes_per_second <= 0:
        return None
    return abs(moment.estimate_bytes_per_second / moment.truth_bytes_per_second - 1.0)


def between(moments: Sequence[Moment], start_s: float, end_s: float) -> list[Moment]:
    """Return the moments from ``start_s`` on and before ``end_s``."""
    return [moment for moment in moments if start_s <= moment.t_s < end_s]


def events(result: ScenarioResult) -> tuple[LinkEvent, ...]:
    """List the plans, and the begin and end of each outage as arpd saw it."""
    found = []
    level, was_out = None, False
    for moment in result.moments:
        is_out = moment.state is LinkState.OUTAGE
        if is_out != was_out:
            found.append(LinkEvent(t_s=moment.t_s, what="outage" if is_out else "outage over"))
        was_out = is_out
        if moment.cause:
            found.append(
                LinkEvent(
                    t_s=moment.t_s,
                    what=moment.cause,
                    before_bytes_per_second=level,
                    after_bytes_per_second=moment.level_bytes_per_second,
                )
            )
        level = moment.level_bytes_per_second if moment.generation else None
    return tuple(found)
