"""Metrics of live AdaptivePublishers (allocation, plan and announcement of each)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.allocation import Binding
from arpd.model.endpoints import SwapPhase, SwapResult, WithheldCause
from arpd.model.plan import NANOSECONDS_PER_SECOND
from arpd.web.families import counter_by, counter_of, gauge_by, gauge_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from prometheus_client.metrics_core import Metric

    from arpd.model.allocation import TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.report.topic_rows import TopicRow
    from arpd.web.families import Labels

_FAILURES = tuple(sorted(set(SwapResult) - {SwapResult.OK}))


def _deadline_s(deadline_ns: int) -> float:
    return deadline_ns / NANOSECONDS_PER_SECOND if deadline_ns else math.inf


_ALLOCATION_GAUGES: tuple[tuple[str, str, Callable[[TopicAllocation], float]], ...] = (
    (
        "arpd_topic_max_rate_hertz",
        "Rmax: the rate that the topic would reach with the link to itself.",
        lambda a: a.max_rate_hz,
    ),
    ("arpd_topic_share_ratio", "Share of link time that the program gives the topic.", lambda a: a.share),
)

_PLAN_GAUGES: tuple[tuple[str, str, Callable[[TopicPlan], float]], ...] = (
    ("arpd_topic_planned_rate_hertz", "Ceiling of the plan; +Inf is unpaced.", lambda p: p.rate_hz),
    (
        "arpd_topic_planned_min_rate_hertz",
        "Floor of the plan; the price does not slow the topic below it while the link carries all floors.",
        lambda p: p.min_rate_hz,
    ),
    ("arpd_topic_planned_depth_samples", "DEPTH of the plan.", lambda p: p.depth),
    (
        "arpd_topic_planned_deadline_seconds",
        "Offered DEADLINE period of the plan; +Inf is none.",
        lambda p: _deadline_s(p.deadline_ns),
    ),
)

_PUBLISHER_GAUGES: tuple[tuple[str, str, Callable[[PublisherState], float]], ...] = (
    ("arpd_topic_confirmed_rate_hertz", "Ceiling announced; +Inf is unpaced.", lambda p: p.rate_hz),
    (
        "arpd_topic_paced_rate_hertz",
        "Rate that the price leaves the publisher, as announced; +Inf is unpaced.",
        lambda p: p.paced_rate_hz,
    ),
    ("arpd_topic_confirmed_depth_samples", "DEPTH announced.", lambda p: p.depth),
    (
        "arpd_topic_confirmed_deadline_seconds",
        "DEADLINE period announced; +Inf is none.",
        lambda p: _deadline_s(p.deadline_ns),
    ),
    (
        "arpd_topic_confirmed_generation",
        "Plan generation the announced settings came from; 0 is the application's own.",
        lambda p: p.generation,
    ),
    ("arpd_topic_source_rate_hertz", "Rate at which the application publishes.", lambda p: p.source_rate_hz),
    ("arpd_topic_published_rate_hertz", "Rate at which messages leave for the link.", lambda p: p.published_rate_hz),
    ("arpd_topic_payload_bytes", "Mean serialized size of recent messages.", lambda p: p.payload_bytes),
    ("arpd_topic_queued_messages", "Messages waiting in the pacing queue.", lambda p: p.queued),
    ("arpd_topic_remote_readers", "Off-host participants that read the topic.", lambda p: p.remote_readers),
    ("arpd_topic_refused", "1 while the publisher refuses the last request.", lambda p: bool(p.refusal)),
)

_PUBLISHER_COUNTERS: tuple[tuple[str, str, Callable[[PublisherState], float]], ...] = (
    ("arpd_topic_offered_messages", "Messages that the application published.", lambda p: p.offered),
    ("arpd_topic_published_messages", "Messages written to the link.", lambda p: p.published),
    ("arpd_topic_publish_blocked_seconds", "Time spent in the middleware's publish().", lambda p: p.blocked_s),
    (
        "arpd_topic_deadlines_missed",
        "Offered DEADLINE periods that passed without a message.",
        lambda p: p.deadlines_missed,
    ),
    (
        "arpd_topic_swaps",
        "Writer swaps begun; each replaces the writer by one with other DEPTH or DEADLINE.",
        lambda p: p.swaps_begun,
    ),
)

_BINDINGS: tuple[tuple[str, str, Callable[[TopicAllocation], Binding]], ...] = (
    ("arpd_topic_rate_binding", "Constraint that stops the rate now.", lambda a: a.binding),
    ("arpd_topic_depth_binding", "Constraint that stopped the depth.", lambda a: a.depth_binding),
)

_COUNTERS_BY: tuple[tuple[str, str, str, tuple[str, ...], Callable[[PublisherState], Mapping[str, float]]], ...] = (
    (
        "arpd_topic_withheld_messages",
        "Messages not sent, by cause: ceiling (rate), price, writer that blocked or failed, publisher that closed.",
        "cause",
        tuple(WithheldCause),
        lambda p: p.withheld_by_cause,
    ),
    (
        "arpd_topic_swap_failures",
        "Writer swaps that went wrong; reorder_possible took place, undelivered may have lost messages.",
        "reason",
        _FAILURES,
        lambda p: {result: count for result, count in p.swaps_by_result.items() if result != SwapResult.OK},
    ),
    (
        "arpd_topic_swap_phase_seconds",
        "Time that writer swaps spent in each phase.",
        "phase",
        tuple(SwapPhase),
        lambda p: p.swap_seconds_by_phase,
    ),
)


def topic_metrics(rows: tuple[TopicRow, ...], *, now_s: float) -> Iterator[Metric]:
    """Yield the families in a fixed order, their series in the order of the rows, with ages at ``now_s``."""
    publishers = [(_labels(row), row.publisher) for row in rows]
    planned = [(_labels(row), row.planned) for row in rows if row.planned is not None]
    allocated = [(_labels(row), row.allocation) for row in rows if row.allocation is not None]
    for name, text, read_row in _ALLOCATION_GAUGES:
        yield gauge_of(name, text, ((labels, read_row(a)) for labels, a in allocated))
    for name, text, read_plan in _PLAN_GAUGES:
        yield gauge_of(name, text, ((labels, read_plan(p)) for labels, p in planned))
    for name, text, read_state in _PUBLISHER_GAUGES:
        yield gauge_of(name, text, ((labels, read_state(p)) for labels, p in publishers))
    yield gauge_of(
        "arpd_topic_announcement_age_seconds",
        "Time since the publisher's announcement.",
        ((labels, p.age_s(now_s)) for labels, p in publishers),
    )
    for name, text, read_total in _PUBLISHER_COUNTERS:
        yield counter_of(name, text, ((labels, read_total(p)) for labels, p in publishers))
    for name, text, binding_of in _BINDINGS:
        yield gauge_by(name, text, "binding", Binding, ((labels, binding_of(a)) for labels, a in allocated))
    for name, text, label, known, read_by in _COUNTERS_BY:
        yield counter_by(name, text, label, known, ((labels, read_by(p)) for labels, p in publishers))


def _labels(row: TopicRow) -> Labels:
    publisher = row.publisher
    return {"topic": publisher.topic, "node": publisher.node, "direction": str(publisher.direction)}
