"""Metrics of live AdaptiveSubscriptions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from prometheus_client.core import GaugeMetricFamily

from arpd.handover import HandoverResult
from arpd.model import NANOSECONDS_PER_SECOND
from arpd.web.families import counter_by

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.metrics_core import Metric

    from arpd.readers import ReaderState
    from arpd.snapshot import Snapshot

_LABELS = ("topic", "node")

_GAUGES: tuple[tuple[str, str, Callable[[ReaderState], float]], ...] = (
    ("arpd_reader_depth_samples", "DEPTH the reader announces.", lambda r: r.depth),
    (
        "arpd_reader_deadline_seconds",
        "DEADLINE period the reader announces to request; +Inf is none.",
        lambda r: r.deadline_ns / NANOSECONDS_PER_SECOND if r.deadline_ns else math.inf,
    ),
    ("arpd_reader_refused", "1 while the last request stands refused, or any would be.", lambda r: bool(r.refusal)),
    ("arpd_reader_announcement_age_seconds", "Time since the reader's announcement.", lambda r: r.age_s),
)


def reader_metrics(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families in a fixed order, their series sorted by topic and node."""
    readers = [((r.topic, r.node), r) for r in sorted(snapshot.observation.readers, key=lambda r: (r.topic, r.node))]
    for name, text, value in (
        ("arpd_readers_managed", "Live readers the plan in force covers.", len(snapshot.reader_plans)),
        ("arpd_readers_confirmed", "Managed readers that announce the plan in force.", snapshot.readers_confirmed),
    ):
        yield GaugeMetricFamily(name, text, value=float(value))
    for name, text, read in _GAUGES:
        gauge = GaugeMetricFamily(name, text, labels=_LABELS)
        for labels, reader in readers:
            gauge.add_metric(labels, float(read(reader)))
        yield gauge
    yield counter_by(
        "arpd_reader_handovers",
        "Handovers of the reader.",
        (*_LABELS, "result"),
        ((labels, HandoverResult, reader.handovers_by_result) for labels, reader in readers),
    )
