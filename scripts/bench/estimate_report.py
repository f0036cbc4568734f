"""The tables of `scripts/bench/estimate.py`: every scenario and way, and the targets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from arpd.cli.columns import aligned
from scripts.bench.report import percent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scripts.bench.estimate_metrics import Metrics

_BURSTS = ("bursts, all lost", "bursts, half lost")
_DROP = ("fall 20 to 5", "fall 20 to 5, unseen")
_DEEP_DROP = ("fall 5 to 1", "fall 5 to 1, unseen")
_OUTAGES = ("outages, lost", "outages, stalled")
_STEADY = ("steady 20", "steady 5")


def _seconds(value: float) -> str:
    return f"{value:.2f}"


def _count(value: float) -> str:
    return f"{value:.1f}"


#: figure → column title, format, and whether more is better
COLUMNS: dict[str, tuple[str, Callable[[float], str], bool]] = {
    "error p50": ("error p50 %", percent, False),
    "error p90": ("error p90 %", percent, False),
    "utilisation": ("utilised %", percent, True),
    "queue peak": ("queue peak s", _seconds, False),
    "queue p99": ("queue p99 s", _seconds, False),
    "levels": ("levels /min", _count, False),
    "swaps": ("swaps /min", _count, False),
    "measuring": ("probes+reports %", lambda value: f"{100 * value:.2f}", False),
}
EVENTS: dict[str, tuple[str, Callable[[float], str], bool]] = {
    name: (name, _seconds, False)
    for name in (
        *("reaction, estimate", "reaction, gate", "rise, estimate", "rise, goodput"),
        *("closed within", "queue in", "queue over oracle", "queue after", "recovery"),
    )
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """A limit for one figure.

    Parameters
    ----------
    title : with the limit in words
    scenarios : their values are one set; none = all scenarios
    limit : for the median, and for the worst seed unless ``worst_limit`` is given
    """

    title: str
    scenarios: tuple[str, ...]
    figure: str
    limit: float
    worst_limit: float | None = None

    def values(self, found: Mapping[str, Mapping[str, list[Metrics]]], way: str) -> list[float]:
        """Return one value per scenario and seed, of the scenarios that were played."""
        scenarios = self.scenarios or tuple(found)
        return [
            metrics[self.figure]
            for name in scenarios
            for metrics in found.get(name, {}).get(way, [])
            if self.figure in metrics
        ]

    def worst(self, values: Sequence[float]) -> float:
        return min(values) if self._more_is_better else max(values)

    def is_met(self, values: Sequence[float]) -> bool:
        """Return whether the median keeps the limit, and the worst seed its own."""
        return self.keeps(median(values)) and self._keeps(
            self.worst(values), self.limit if self.worst_limit is None else self.worst_limit
        )

    def keeps(self, value: float | None) -> bool:
        """Return whether a median keeps the limit; never (None) does not."""
        return value is not None and self._keeps(value, self.limit)

    @property
    def unit(self) -> str:
        """Unit of the numbers that `shown` writes."""
        title, write, _ = (COLUMNS | EVENTS)[self.figure]
        return "s" if write is _seconds else "%" if title.endswith("%") else ""

    @property
    def _more_is_better(self) -> bool:
        return (COLUMNS | EVENTS)[self.figure][2]

    def _keeps(self, value: float, limit: float) -> bool:
        return value >= limit if self._more_is_better else value <= limit

    def shown(self, value: float) -> str:
        _, write, _ = (COLUMNS | EVENTS)[self.figure]
        return write(value) if math.isfinite(value) else "never"


TARGETS = (
    Target(
        title="reaction of the estimate to 20→5: <= 0.6 s median, never > 1.5 s",
        scenarios=_DROP,
        figure="reaction, estimate",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(
        title="reaction of the gate to 20→5: <= 0.6 s median, never > 1.5 s",
        scenarios=_DROP,
        figure="reaction, gate",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(title="queue peak, 20→5: <= 0.6 s", scenarios=_DROP, figure="queue peak", limit=0.6),
    Target(title="queue peak, 5→1: <= 1.0 s", scenarios=_DEEP_DROP, figure="queue peak", limit=1.0),
    Target(
        title="rise 5→20 to 80 %, estimate: <= 7 s", scenarios=("rise 5 to 20",), figure="rise, estimate", limit=7.0
    ),
    Target(title="rise 5→20 to 80 %, goodput: <= 7 s", scenarios=("rise 5 to 20",), figure="rise, goodput", limit=7.0),
    Target(title="steady error, p90: <= 10 %", scenarios=_STEADY, figure="error p90", limit=0.10),
    Target(title="steady, share of the oracle's goodput: >= 95 %", scenarios=_STEADY, figure="utilisation", limit=0.95),
    Target(title="levels per minute, steady: <= 0.2", scenarios=_STEADY, figure="levels", limit=0.2),
    Target(title="levels per minute, noisy: <= 1", scenarios=("noisy",), figure="levels", limit=1.0),
    Target(title="levels per minute, any scenario: <= 6", scenarios=(), figure="levels", limit=6.0),
    Target(title="probes and reports, any scenario: <= 1 % of capacity", scenarios=(), figure="measuring", limit=0.01),
    Target(title="outage, gate closed within: <= 0.5 s", scenarios=_OUTAGES, figure="closed within", limit=0.5),
    # A delay above 100 ms is a queue: docs/design.md, The estimator.
    Target(
        title="outage that loses, no queue built: <= 0.1 s", scenarios=("outages, lost",), figure="queue in", limit=0.1
    ),
    Target(
        # Until the gate closes, samples queue: 0.85 of the link for 0.3 s without a ping or a report.
        title="outage that stalls, queue at its end beyond the oracle's: <= 0.26 s",
        scenarios=("outages, stalled",),
        figure="queue over oracle",
        limit=0.26,
    ),
    Target(title="outage, recovery to 80 %: <= 5 s", scenarios=_OUTAGES, figure="recovery", limit=5.0),
    Target(
        title="burst loss, share of the oracle's goodput: >= 75 %", scenarios=_BURSTS, figure="utilisation", limit=0.75
    ),
    Target(title="burst loss, queue peak: <= 1 s", scenarios=_BURSTS, figure="queue peak", limit=1.0),
    Target(
        title="oscillation 5 s, share of the oracle's goodput: >= 75 %",
        scenarios=("oscillation 5 s",),
        figure="utilisation",
        limit=0.75,
    ),
    Target(title="oscillation 5 s, queue peak: <= 1 s", scenarios=("oscillation 5 s",), figure="queue peak", limit=1.0),
)


def scenario_table(found: Mapping[str, Mapping[str, list[Metrics]]], *, seeds: int) -> str:
    """Return a row per scenario and way: the median of the seeds, and the worst in brackets if it differs."""
    rows = [["scenario", "way", *(title for title, *_ in COLUMNS.values())]]
    for name, ways in found.items():
        rows += [
            [name if i == 0 else "", way, *(_cell(figure, every) for figure in COLUMNS)]
            for i, (way, every) in enumerate(ways.items())
        ]
    lines = [f"median of {seeds} seeds (worst seed)", "", *_columns(rows)]
    events = [
        [name, way, *(_cell(figure, every) for figure in EVENTS)]
        for name, ways in found.items()
        for way, every in ways.items()
        if any(figure in every[0] for figure in EVENTS)
    ]
    if events:
        lines += ["", *_columns([["scenario", "way", *(f"{title} s" for title in EVENTS)], *events])]
    return "\n".join(lines)


def target_table(found: Mapping[str, Mapping[str, list[Metrics]]], way: str) -> str:
    """Return a row per target with median, worst, and whether it is met."""
    rows = [["target", "median", "worst", "met"]]
    for target in TARGETS:
        if values := target.values(found, way):
            met = "yes" if target.is_met(values) else "NO"
            rows.append([target.title, target.shown(median(values)), target.shown(target.worst(values)), met])
    return "\n".join(_columns(rows))


def _cell(figure: str, every: Sequence[Metrics]) -> str:
    _, write, more_is_better = (COLUMNS | EVENTS)[figure]
    values = [metrics[figure] for metrics in every if figure in metrics]
    if not values:
        return "-"
    middle, worst = (
        write(value) if math.isfinite(value) else "never"
        for value in (median(values), min(values) if more_is_better else max(values))
    )
    return middle if middle == worst else f"{middle} ({worst})"


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    return aligned(rows, words=len(rows[0]) - 1)
