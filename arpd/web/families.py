"""Makes metric families from rows of labels and values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Sample

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from arpd.report.durations import Distribution

# There may be thousands of samples. Samples made here share the labels of their row; `add_metric` would copy them.
Labels = dict[str, str]


def gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    """Return a gauge without labels."""
    return GaugeMetricFamily(name, text, value=float(value))


def gauge_of(name: str, text: str, series: Iterable[tuple[Labels, float]]) -> GaugeMetricFamily:
    """Return a gauge over (labels, value)."""
    family = GaugeMetricFamily(name, text)
    family.samples = [Sample(name, each, value) for each, value in series]
    return family


def counter_of(name: str, text: str, series: Iterable[tuple[Labels, float]]) -> CounterMetricFamily:
    """Return a counter over (labels, count)."""
    family, name = CounterMetricFamily(name, text), f"{name}_total"
    family.samples = [Sample(name, each, count) for each, count in series]
    return family


def gauge_by(
    name: str, text: str, label: str, known: Iterable[str], series: Iterable[tuple[Labels, str]]
) -> GaugeMetricFamily:
    """Return a set of states over (outer labels, current one of the known values of another label)."""
    family = GaugeMetricFamily(name, f"{text} 1 marks the current one.")
    states = sorted(map(str, known))
    family.samples = [
        Sample(name, {**outer, label: state}, float(state == current)) for outer, current in series for state in states
    ]
    return family


def counter_by(
    name: str, text: str, label: str, known: Iterable[str], series: Iterable[tuple[Labels, Mapping[str, float]]]
) -> CounterMetricFamily:
    """Return a counter over (outer labels, counts by another label); a known value without a count gets 0."""
    family, name = CounterMetricFamily(name, text), f"{name}_total"
    usual = sorted(map(str, known))
    for outer, counts in series:
        values = usual if all(value in usual for value in counts) else sorted({*usual, *counts})
        family.samples += [Sample(name, {**outer, label: value}, counts.get(value, 0)) for value in values]
    return family


def histogram(name: str, text: str, distribution: Distribution) -> HistogramMetricFamily:
    """Return a histogram without labels."""
    return HistogramMetricFamily(name, text, buckets=_buckets(distribution), sum_value=distribution.total_s)


def histogram_by(name: str, text: str, label: str, distributions: Mapping[str, Distribution]) -> HistogramMetricFamily:
    """Return a histogram over the values of one label."""
    family = HistogramMetricFamily(name, text, labels=(label,))
    for value, distribution in sorted(distributions.items()):
        family.add_metric((value,), _buckets(distribution), distribution.total_s)
    return family


def _buckets(distribution: Distribution) -> list[tuple[str, float]]:
    return [("+Inf" if math.isinf(bound) else str(bound), count) for bound, count in distribution.up_to]
