"""Metrics of live AdaptiveSubscriptions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.adapters.http.families import counter_by, counter_of, gauge, gauge_of
from arpd.model.endpoints import ReaderSwapResult
from arpd.model.plan import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.metrics_core import Metric

    from arpd.model.endpoints import ReaderState
    from arpd.report.snapshot import Snapshot

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
    ordered = sorted(snapshot.observation.readers, key=lambda r: (r.topic, r.node))
    readers = [({"topic": reader.topic, "node": reader.node}, reader) for reader in ordered]
    for name, text, value in (
        ("arpd_readers_managed", "Live readers the plan in force covers.", len(snapshot.reader_plans)),
        ("arpd_readers_confirmed", "Managed readers that announce the plan in force.", snapshot.readers_confirmed),
    ):
        yield gauge(name, text, value)
    for name, text, read in _GAUGES:
        yield gauge_of(name, text, ((labels, float(read(reader))) for labels, reader in readers))
    yield counter_of(
        "arpd_reader_deadlines_missed",
        "Requested DEADLINE periods that passed without a message.",
        ((labels, reader.deadlines_missed) for labels, reader in readers),
    )
    yield counter_by(
        "arpd_reader_handovers",
        "Handovers of the reader.",
        "result",
        ReaderSwapResult,
        ((labels, reader.swaps_by_result) for labels, reader in readers),
    )
