"""Figures of a simulated run over a span of time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from arpd.sim.result import percentile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.daemon.scenario import Moment, ScenarioResult

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


def summarize(result: ScenarioResult, *, start_s: float, end_s: float) -> Summary:
    """Summarise the moments of a span of run time, at least a second long (s)."""
    span = between(result.moments, start_s, end_s)
    first, last = span[0], span[-1]
    elapsed_s = last.t_s - first.t_s
    queues = [moment.queue_delay_s for moment in span]
    errors = [
        abs(moment.estimate_bytes_per_second / moment.truth_bytes_per_second - 1.0)
        for moment in span
        if moment.estimate_bytes_per_second is not None and moment.truth_bytes_per_second > 0
    ]
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


def between(moments: Sequence[Moment], start_s: float, end_s: float) -> list[Moment]:
    """Return the moments from ``start_s`` on and before ``end_s``."""
    return [moment for moment in moments if start_s <= moment.t_s < end_s]
