"""The figures of `scripts/bench/estimate.py` and their definitions; moments are sampled at 10 Hz.

The window is from 10 s to the end of the run, without the start-up. Moments without service (rate 0) do not count for
errors and queues: while the link stalls, every queue lasts until its end.

error p50, p90      |Rmax estimated / Rmax true - 1| of the robot's average packet at p50 and p90 of the moments;
                    Rmax = 1 / (t_ovh + bytes / capacity). If packets cost only their bytes, that is the error of the
                    capacity. The true t_ovh of a link that aggregates is that of a full aggregate.
utilisation         payload delivered in the window, over the bound's on the same seed. A standing queue delivers more
                    than the bound, but later: compare with the queue
carried             wire bytes carried in the window, over those that the link could carry
queue p50 to peak   time that a packet sent now would wait on the robot's side: percentiles, and the longest (s)
lost                samples that were sent and never arrived, start-up included; and how many more than the bound's,
                    counted topic by topic
levels, swaps       plans made, and writers replaced (all topics together), per minute of the window
measuring           wire bytes of probes and reports, both directions, over the capacity of the link in the window
reaction, estimate  from the fall until the estimate is within 15 % of the new truth and stays there for a second (s)
reaction, budget    from the fall until the budget is at most a tenth above the new truth and stays so for a second (s)
queue over bound    queue p50 from the fall to the end of the run, less the bound's (s)
queue p99 / bound   queue p99 over the bound's
rise, estimate      from the rise until the estimate is above 80 % of the new truth and stays there for a second (s)
rise, goodput       from the rise until the delivery of the last half second is above 80 % of the bound's mean over the
                    last 10 s of the run. Over a whole second, not even the bound could be there after one (s)
near zero, queue    longest queue of the spans in which the link carries next to nothing. The first 10 s do not count:
                    there, what was on its way at the fall has to leave (s)
carried / fluid     wire bytes carried in the window, over those of the fluid controller (`estimate_fluid`)
queue p95 / fluid   queue p95 over the fluid controller's
closed within       worst of the outages: from its start until the budget is at most a tenth of that just before (s)
queue in            worst of the outages: longest queue from 0.5 s after its start to the first moment after it (s). If
                    the link stalls, only that moment counts: its queue holds the samples from before the budget was 0
                    and the floors and heartbeats of the whole outage, which even the bound sends
queue in over bound worst of the outages: "queue in" less the bound's (s)
queue after         worst of the outages: longest queue in the 5 s after it (s)
recovery            worst of the outages: from its end until the delivery of the last half second is above 80 % of the
                    mean of the 5 s before the outage (s)

An event that never happens is infinite, and null in JSON.
"""

from __future__ import annotations

import math
import operator
from typing import TYPE_CHECKING

from arpd.adapters.sim.result import percentile
from arpd.daemon.compare import WARM_UP_S, between, summarize
from arpd.model.endpoints import Direction
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.daemon.scenario import Moment, ScenarioResult
    from scripts.bench.estimate_scenarios import Scenario

_NEAR = 0.15
_HOLDS_S = 1.0
_DELIVERY_S = 0.5
_CLOSED = 0.1
_TIME_TO_CLOSE_S = 0.5
_TIME_TO_DRAIN_S = 10.0
_MOMENT_S = 0.1
_LEAST_S = 1e-3  # of a queue by which another one is divided

Metrics = dict[str, float]


def measure(
    scenario: Scenario,
    result: ScenarioResult,
    *,
    bound: ScenarioResult | None = None,
    fluid: ScenarioResult | None = None,
) -> Metrics:
    """Return every figure that applies to this scenario; some need the bound's or the fluid controller's run."""
    moments, end_s = result.moments, scenario.duration_s
    summary = summarize(result, start_s=WARM_UP_S, end_s=end_s)
    errors = _errors(scenario, _served(scenario, result))
    found = {
        "error p50": percentile(errors, 0.5) or 0.0,
        "error p90": percentile(errors, 0.9) or 0.0,
        **carried(scenario, result),
        "goodput": summary.goodput_bytes_per_second,
        "lost": sum(topic.lost for topic in result.topics),
        "levels": summary.plans_per_minute,
        "swaps": summary.swaps_per_minute,
        "measuring": summary.measuring_share,
    }
    for fall_s in scenario.falls:
        after = between(moments, fall_s, end_s)
        found["reaction, estimate"] = _until(after, _is_near)
        found["reaction, budget"] = _until(after, lambda m: _budget(m) <= 1.1 * m.truth_bytes_per_second)
    for rise_s in scenario.rises:
        after = between(moments, rise_s, end_s)
        found["rise, estimate"] = _until(after, lambda m: _estimate(m) > 0.8 * m.truth_bytes_per_second)
    for low_s, risen_s in scenario.lows:
        found["near zero, queue"] = max(m.queue_delay_s for m in between(moments, low_s + _TIME_TO_DRAIN_S, risen_s))
    if scenario.outages:
        found |= _outages(scenario, moments)
    if bound is not None:
        found |= _beside_bound(scenario, result, bound)
    if fluid is not None:
        theirs = carried(scenario, fluid)
        found["carried / fluid"] = found["carried"] / theirs["carried"]
        found["queue p95 / fluid"] = found["queue p95"] / max(_LEAST_S, theirs["queue p95"])
    return found


def carried(scenario: Scenario, result: ScenarioResult) -> Metrics:
    """Return the figures that even a fluid has: the share of the link that was carried, and the queue."""
    queues = [moment.queue_delay_s for moment in _served(scenario, result)]
    return {
        "carried": summarize(result, start_s=WARM_UP_S, end_s=scenario.duration_s).carried_share,
        **{f"queue {name}": percentile(queues, q) or 0.0 for name, q in (("p50", 0.5), ("p95", 0.95), ("p99", 0.99))},
        "queue peak": max(queues),
    }


def _beside_bound(scenario: Scenario, result: ScenarioResult, bound: ScenarioResult) -> Metrics:
    moments, end_s = result.moments, scenario.duration_s
    ours, theirs = (summarize(each, start_s=WARM_UP_S, end_s=end_s) for each in (result, bound))
    queues = [carried(scenario, each)["queue p99"] for each in (result, bound)]
    found = {
        "utilisation": ours.goodput_bytes_per_second / theirs.goodput_bytes_per_second,
        "queue p99 / bound": queues[0] / max(_LEAST_S, queues[1]),
        "lost beyond bound": sum(
            max(0, topic.lost - same.lost) for topic, same in zip(result.topics, bound.topics, strict=True)
        ),
    }
    for fall_s in scenario.falls:
        after = (between(each.moments, fall_s, end_s) for each in (result, bound))
        medians = [percentile([moment.queue_delay_s for moment in span], 0.5) or 0.0 for span in after]
        found["queue over bound"] = medians[0] - medians[1]
    for rise_s in scenario.rises:
        most = summarize(bound, start_s=end_s - 10.0, end_s=end_s).goodput_bytes_per_second
        found["rise, goodput"] = _delivering(moments, rise_s, end_s, 0.8 * most)
    if scenario.outages:
        within = (_queues_within(scenario, each.moments) for each in (result, bound))
        found["queue in over bound"] = max(map(operator.sub, *within))
    return found


def _served(scenario: Scenario, result: ScenarioResult) -> list[Moment]:
    """Return the moments of the window in which the link carries something."""
    window = between(result.moments, WARM_UP_S, scenario.duration_s)
    return [moment for moment in window if moment.truth_bytes_per_second > 0]


def _errors(scenario: Scenario, moments: Sequence[Moment]) -> list[float]:
    """Return the errors of Rmax for the robot's average packet, overhead included."""
    robot = [topic for topic in scenario.robot if topic.direction is Direction.SENSING]
    sizes = [wire_size(topic.payload_bytes, rate_hz=topic.rate_hz) for topic in robot]
    packets = sum(topic.rate_hz * count for topic, (_, count) in zip(robot, sizes, strict=True))
    packet_bytes = sum(topic.rate_hz * size for topic, (size, _) in zip(robot, sizes, strict=True)) / packets
    overhead_s = scenario.model.packet_overhead_s / scenario.model.aggregate_packets
    return [
        abs(
            (overhead_s + packet_bytes / m.truth_bytes_per_second)
            / ((m.packet_overhead_s or 0.0) + packet_bytes / m.estimate_bytes_per_second)
            - 1.0
        )
        for m in moments
        if m.estimate_bytes_per_second
    ]


def _outages(scenario: Scenario, moments: Sequence[Moment]) -> Metrics:
    closed, after, recoveries = [], [], []
    for i, (start_s, end_s) in enumerate(scenario.outages):
        next_s = scenario.outages[i + 1][0] if i + 1 < len(scenario.outages) else scenario.duration_s
        before = between(moments, start_s - 5.0, start_s)
        closed.append(_closed_s(between(moments, start_s, end_s), _CLOSED * _budget(before[-1])))
        after.append(max(m.queue_delay_s for m in between(moments, end_s, min(next_s, end_s + 5.0))))
        mean = (before[-1].delivered_bytes - before[0].delivered_bytes) / (before[-1].t_s - before[0].t_s)
        recoveries.append(_delivering(moments, end_s, next_s, 0.8 * mean))
    return {
        "closed within": max(closed),
        "queue in": max(_queues_within(scenario, moments)),
        "queue after": max(after),
        "recovery": max(recoveries),
    }


def _closed_s(moments: Sequence[Moment], little: float) -> float:
    return _until(moments, lambda moment: _budget(moment) <= little, holds_s=0.0)


def _queues_within(scenario: Scenario, moments: Sequence[Moment]) -> list[float]:
    """Return the longest queue of each outage (s)."""
    spans = (between(moments, start_s + _TIME_TO_CLOSE_S, end_s + _MOMENT_S / 2) for start_s, end_s in scenario.outages)
    return [max(m.queue_delay_s for m in span if m.truth_bytes_per_second > 0) for span in spans]


def _estimate(moment: Moment) -> float:
    return moment.estimate_bytes_per_second or 0.0


def _budget(moment: Moment) -> float:
    return math.inf if moment.budget_bytes_per_second is None else moment.budget_bytes_per_second


def _is_near(moment: Moment) -> bool:
    return abs(_estimate(moment) / moment.truth_bytes_per_second - 1) <= _NEAR


def _until(moments: Sequence[Moment], holds: Callable[[Moment], bool], *, holds_s: float = _HOLDS_S) -> float:
    """Return the time until ``holds`` begins to hold for ``holds_s`` (s); infinite if it never does."""
    since_s = None
    for moment in moments:
        if not holds(moment):
            since_s = None
            continue
        since_s = moment.t_s if since_s is None else since_s
        if moment.t_s - since_s >= holds_s - 1e-9:
            return since_s - moments[0].t_s
    return math.inf


def _delivering(moments: Sequence[Moment], start_s: float, end_s: float, rate: float) -> float:
    """Return the time after ``start_s`` until half a second has delivered at this rate (s)."""
    window = round(_DELIVERY_S / _MOMENT_S)
    return next(
        (
            moment.t_s - start_s
            for before, moment in zip(moments, moments[window:], strict=False)
            if start_s < moment.t_s < end_s
            and moment.delivered_bytes - before.delivered_bytes > rate * (moment.t_s - before.t_s)
        ),
        math.inf,
    )
