"""Metric families that several modules make alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


def counter_by(
    name: str,
    text: str,
    labels: tuple[str, ...],
    series: Iterable[tuple[tuple[str, ...], Iterable[str], Mapping[str, int]]],
) -> CounterMetricFamily:
    """Return a counter over (outer labels, known values of the last label, counts); a known value has a count, or 0."""
    family = CounterMetricFamily(name, text, labels=labels)
    for outer, known, counts in series:
        for value in sorted({*known, *counts}):
            family.add_metric((*outer, value), counts.get(value, 0))
    return family
