"""Metrics of what arrives from the network and is not believed."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from arpd.observe.rate_limits import Kind, Reason

if TYPE_CHECKING:
    from collections.abc import Iterator

    from prometheus_client.metrics_core import Metric

    from arpd.report.snapshot import Snapshot


def intake_metrics(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families in a fixed order; every label has few values, whoever speaks."""
    taken = snapshot.observation.taken
    refused = CounterMetricFamily(
        "arpd_messages_refused",
        "Messages from the network, or parts of them, that were not believed.",
        labels=("kind", "reason"),
    )
    for kind, reason in product(Kind, Reason):
        refused.add_metric((kind, reason), taken.refused.get((kind, reason), 0))
    yield refused
    yield GaugeMetricFamily(
        "arpd_endpoints_pending",
        "Publishers and readers that announce themselves, but that the ROS graph does not show.",
        value=float(taken.pending),
    )
