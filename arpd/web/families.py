"""Makes metric families from rows of labels and values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Sample

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from prometheus_client.core import Metric

    from arpd.report.durations import Distribution

Labels: TypeAlias = dict[str, str]
Rows: TypeAlias = "Iterable[tuple[Labels, float]]"  # there may be thousands


def family(name: str, text: str, value: Rows | float | None) -> Metric:
    """Return a counter if the name ends in ``_total`` and a gauge otherwise; None is unknown and has no series."""
    made = CounterMetricFamily(name, text) if name.endswith("_total") else GaugeMetricFamily(name, text)
    rows = () if value is None else [({}, value)] if isinstance(value, int | float) else value
    # Samples made here share the labels of their row; `add_metric` would copy them.
    made.samples = [Sample(name, labels, float(number)) for labels, number in rows]
    return made


def states(label: str, known: Iterable[str], current: str, **outer: str) -> Rows:
    """Return a row for each known state; 1 marks the current one."""
    return [({**outer, label: state}, state == current) for state in sorted({*map(str, known), str(current)})]


def counts(label: str, known: Iterable[str], found: Mapping[str, float], outer: Labels | None = None) -> Rows:
    """Return a row for each known value, from zero so that rate() sees the first; no message can add another."""
    return [({**(outer or {}), label: value}, found.get(value, 0)) for value in sorted(map(str, known))]


def histogram(name: str, text: str, distribution: Distribution) -> Metric:
    """Return a histogram without labels."""
    buckets = [("+Inf" if math.isinf(bound) else str(bound), count) for bound, count in distribution.up_to]
    return HistogramMetricFamily(name, text, buckets=buckets, sum_value=distribution.total_s)
