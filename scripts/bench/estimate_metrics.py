"""The figures of `scripts/bench/estimate.py` and their definitions; moments are sampled at 10 Hz.

The window is from 10 s to the end of the run, without the start-up.

error p50, p90      |Rmax estimated / Rmax true - 1| of the robot's average packet at p50 and p90 of the moments;
                    Rmax = 1 / (t_ovh + bytes / capacity). If packets cost only their bytes, that is the error of the
                    capacity. Moments without service (rate 0) do not count. The true t_ovh of a link that aggregates
                    is that of a full aggregate.
reaction, estimate  from the fall until the estimate is within 25 % of the new truth and stays there for a second (s)
reaction, gate      from the fall until gate x level fits into the new truth and stays so for a second (s)
rise, estimate      from the rise until the estimate is above 80 % of the new truth and stays there for a second (s)
rise, goodput       from the rise until the delivery of the last second is above 80 % of the oracle's mean over the last
                    10 s of the run; at least about a second, because it is averaged over one (s)
queue peak, p99     longest queue on the robot's side, and its p99 (s). When an outage stalls the link, every queue
                    lasts until its end, so moments without service do not count
utilisation         payload delivered in the window, over the oracle's on the same seed. A standing queue delivers more
                    than the oracle, but later: compare with the queue
levels, swaps       plans made, and writers replaced (all topics together), per minute of the window
measuring           wire bytes of probes and reports, both directions, over the capacity of the link in the window
closed within       worst of the outages: from its start until the gate is at most 0.1 (s)
queue in            worst of the outages: longest queue from 0.5 s after its start to the first moment after it (s). If
                    the link stalls, only that moment counts: its queue holds the samples from before the gate closed
                    and the floors and heartbeats of the whole outage, which even the oracle sends
queue over oracle   worst of the outages: "queue in" less the oracle's (s)
queue after         worst of the outages: longest queue in the 5 s after it (s)
recovery            worst of the outages: from its end until the delivery of the last second is above 80 % of the mean
                    of the 5 s before the outage; at least about a second, as above (s)

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

_HOLDS_S = 1.0
_CLOSED = 0.1
_TIME_TO_CLOSE_S = 0.5
_MOMENT_S = 0.1

Metrics = dict[str, float]


def measure(scenario: Scenario, result: ScenarioResult, oracle: ScenarioResult | None) -> Metrics:
    """Return every figure that applies to this scenario; utilisation needs the oracle's run."""
    moments, end_s = result.moments, scenario.duration_s
    summary = summarize(result, start_s=WARM_UP_S, end_s=end_s)
    served = [m for m in between(moments, WARM_UP_S, end_s) if m.truth_bytes_per_second > 0]
    errors = _errors(scenario, served)
    queues = [moment.queue_delay_s for moment in served]
    found = {
        "error p50": percentile(errors, 0.5) or 0.0,
        "error p90": percentile(errors, 0.9) or 0.0,
        "queue peak": max(queues),
        "queue p99": percentile(queues, 0.99) or 0.0,
        "goodput": summary.goodput_bytes_per_second,
        "levels": summary.levels_per_minute,
        "swaps": summary.swaps_per_minute,
        "measuring": summary.measuring_share,
    }
    for fall_s in scenario.falls:
        after = between(moments, fall_s, end_s)
        found["reaction, estimate"] = _until(after, lambda m: abs(_estimate(m) / m.truth_bytes_per_second - 1) <= 0.25)
        found["reaction, gate"] = _until(
            after, lambda m: m.gate * (m.level_bytes_per_second or math.inf) <= m.truth_bytes_per_second
        )
    for rise_s in scenario.rises:
        after = between(moments, rise_s, end_s)
        found["rise, estimate"] = _until(after, lambda m: _estimate(m) > 0.8 * m.truth_bytes_per_second)
    if scenario.outages:
        found |= _outages(scenario, moments)
    if oracle is not None:
        if scenario.outages:
            ours, theirs = (_queues_within(scenario, each) for each in (moments, oracle.moments))
            found["queue over oracle"] = max(map(operator.sub, ours, theirs))
        reference = summarize(oracle, start_s=WARM_UP_S, end_s=end_s).goodput_bytes_per_second
        found["utilisation"] = summary.goodput_bytes_per_second / reference
        for rise_s in scenario.rises:
            most = summarize(oracle, start_s=end_s - 10.0, end_s=end_s).goodput_bytes_per_second
            found["rise, goodput"] = _delivering(moments, rise_s, end_s, 0.8 * most)
    return found


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
        closed.append(_until(between(moments, start_s, end_s), lambda m: m.gate <= _CLOSED, holds_s=0.0))
        after.append(max(m.queue_delay_s for m in between(moments, end_s, min(next_s, end_s + 5.0))))
        before = between(moments, start_s - 5.0, start_s)
        mean = (before[-1].delivered_bytes - before[0].delivered_bytes) / (before[-1].t_s - before[0].t_s)
        recoveries.append(_delivering(moments, end_s, next_s, 0.8 * mean))
    return {
        "closed within": max(closed),
        "queue in": max(_queues_within(scenario, moments)),
        "queue after": max(after),
        "recovery": max(recoveries),
    }


def _queues_within(scenario: Scenario, moments: Sequence[Moment]) -> list[float]:
    """Return the longest queue of each outage (s)."""
    spans = (between(moments, start_s + _TIME_TO_CLOSE_S, end_s + _MOMENT_S / 2) for start_s, end_s in scenario.outages)
    return [max(m.queue_delay_s for m in span if m.truth_bytes_per_second > 0) for span in spans]


def _estimate(moment: Moment) -> float:
    return moment.estimate_bytes_per_second or 0.0


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
    """Return the time after ``start_s`` until a whole second has delivered at this rate (s)."""
    window = round(1.0 / _MOMENT_S)
    return next(
        (
            moment.t_s - start_s
            for before, moment in zip(moments, moments[window:], strict=False)
            if start_s < moment.t_s < end_s
            and moment.delivered_bytes - before.delivered_bytes > rate * (moment.t_s - before.t_s)
        ),
        math.inf,
    )
