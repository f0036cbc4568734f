"""Metrics of live AdaptivePublishers (plan and announcement of each): about twenty series for one."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.endpoints import SwapResult, WithheldCause
from arpd.model.plan import NANOSECONDS_PER_SECOND
from arpd.web.families import counts, family

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.core import Metric

    from arpd.report.topic_rows import TopicRow

_NO_FAILURES = {SwapResult.OK, SwapResult.SUPERSEDED, SwapResult.REORDER_POSSIBLE}

_OF_ROW: tuple[tuple[str, str, Callable[[TopicRow], float | None]], ...] = (
    (
        "share_ratio",
        "Share of link time that the program gives the topic.",
        lambda r: None if r.allocation is None else r.allocation.share,
    ),
    (
        "planned_min_rate_hertz",
        "Minimum rate of the plan; the price slows the topic below it only where not all minimum rates fit.",
        lambda r: None if r.planned is None else r.planned.min_rate_hz,
    ),
    (
        "paced_rate_hertz",
        "Rate that plan and price leave the publisher, as announced; +Inf is unpaced.",
        lambda r: r.publisher.paced_rate_hz,
    ),
    ("confirmed_depth_samples", "DEPTH announced.", lambda r: r.publisher.depth),
    (
        "confirmed_deadline_seconds",
        "DEADLINE period announced; +Inf is none.",
        lambda r: r.publisher.deadline_ns / NANOSECONDS_PER_SECOND or math.inf,
    ),
    ("source_rate_hertz", "Rate at which the application publishes.", lambda r: r.publisher.source_rate_hz),
    ("published_rate_hertz", "Rate at which messages leave for the link.", lambda r: r.publisher.published_rate_hz),
    ("payload_bytes", "Mean serialized size of recent messages.", lambda r: r.publisher.payload_bytes),
    ("queued_messages", "Messages waiting in the pacing queue.", lambda r: r.publisher.queued),
    ("remote_readers", "Off-host participants that read the topic.", lambda r: r.publisher.remote_readers),
    ("offered_messages_total", "Messages that the application published.", lambda r: r.publisher.offered),
    ("published_messages_total", "Messages written to the link.", lambda r: r.publisher.published),
    (
        "publish_blocked_seconds_total",
        "Time spent in the middleware's publish().",
        lambda r: r.publisher.blocked_s,
    ),
    (
        "deadlines_missed_total",
        "Offered DEADLINE periods that passed without a message.",
        lambda r: r.publisher.deadlines_missed,
    ),
    (
        "swaps_total",
        "Writer swaps begun; each replaces the writer by one with other DEPTH or DEADLINE.",
        lambda r: r.publisher.swaps_begun,
    ),
    (
        "swap_failures_total",
        "Writer swaps that replaced no writer or may have lost messages.",
        lambda r: sum(many for result, many in r.publisher.swaps_by_result.items() if result not in _NO_FAILURES),
    ),
)


def topic_metrics(rows: tuple[TopicRow, ...]) -> Iterator[Metric]:
    """Yield the families in a fixed order, their series in the order of the rows."""
    labelled = [
        ({"topic": p.topic, "node": p.node, "direction": str(p.direction)}, row)
        for p, row in ((row.publisher, row) for row in rows)
    ]
    for name, text, read in _OF_ROW:
        found = ((labels, read(row)) for labels, row in labelled)
        yield family(f"arpd_topic_{name}", text, ((labels, value) for labels, value in found if value is not None))
    yield family(
        "arpd_topic_withheld_messages_total",
        "Messages not sent, by cause: ceiling (rate), price, writer that blocked or failed, publisher that closed.",
        (
            series
            for labels, row in labelled
            for series in counts("cause", WithheldCause, row.publisher.withheld_by_cause, labels)
        ),
    )
