"""The tables of `scripts/bench/estimate.py`: every scenario and way, and what was to be shown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from arpd.cli.columns import aligned

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scripts.bench.estimate_metrics import Metrics

_BURSTS = ("bursts, all lost", "bursts, half lost")
_DROP = ("fall 20 to 5", "fall 20 to 5, unseen")
_DEEP_DROP = ("fall 5 to 1", "fall 5 to 1, unseen")
_OUTAGES = ("outages, lost", "outages, stalled")
_STEADY = ("steady 20", "steady 5")


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def _seconds(value: float) -> str:
    return f"{value:.2f}"


def _count(value: float) -> str:
    return f"{value:.1f}"


#: figure → column title, how it is written, whether more is better
COLUMNS: dict[str, tuple[str, Callable[[float], str], bool]] = {
    "error p50": ("error p50 %", _percent, False),
    "error p90": ("error p90 %", _percent, False),
    "utilisation": ("utilised %", _percent, True),
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
    """One thing to be shown.

    Parameters
    ----------
    title : with the limit in words
    scenarios, figure : where it is read; the values of several scenarios are one set
    limit : what the median must keep, and the worst too unless ``worst_limit`` says otherwise
    at_least : whether the limit is one from below
    """

    title: str
    scenarios: tuple[str, ...]
    figure: str
    limit: float
    worst_limit: float | None = None
    at_least: bool = False

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
        return min(values) if self.at_least else max(values)

    def is_met(self, values: Sequence[float]) -> bool:
        """Whether the median keeps the limit, and the worst seed its own."""
        return self.keeps(median(values)) and self._keeps(
            self.worst(values), self.limit if self.worst_limit is None else self.worst_limit
        )

    def keeps(self, value: float | None) -> bool:
        """Whether a median keeps the limit; what never happened (None) does not."""
        return value is not None and self._keeps(value, self.limit)

    @property
    def unit(self) -> str:
        """The unit of what `shown` writes."""
        title, write, _ = (COLUMNS | EVENTS)[self.figure]
        return "s" if write is _seconds else "%" if title.endswith("%") else ""

    def _keeps(self, value: float, limit: float) -> bool:
        return value >= limit if self.at_least else value <= limit

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
    Target(
        title="queue peak, 20→5: <= 0.6 s",
        scenarios=_DROP,
        figure="queue peak",
        limit=0.6,
    ),
    Target(
        title="queue peak, 5→1: <= 1.0 s",
        scenarios=_DEEP_DROP,
        figure="queue peak",
        limit=1.0,
    ),
    Target(
        title="rise 5→20 to 80 %, estimate: <= 7 s", scenarios=("rise 5 to 20",), figure="rise, estimate", limit=7.0
    ),
    Target(title="rise 5→20 to 80 %, goodput: <= 7 s", scenarios=("rise 5 to 20",), figure="rise, goodput", limit=7.0),
    Target(title="steady error, p90: <= 10 %", scenarios=_STEADY, figure="error p90", limit=0.10),
    Target(
        title="steady, share of the oracle's goodput: >= 95 %",
        scenarios=_STEADY,
        figure="utilisation",
        limit=0.95,
        at_least=True,
    ),
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
        # What comes in until the gate closes waits: 0.85 of the link for the 0.3 s that no ping and no report comes.
        title="outage that stalls, queue at its end beyond the oracle's: <= 0.26 s",
        scenarios=("outages, stalled",),
        figure="queue over oracle",
        limit=0.26,
    ),
    Target(title="outage, recovery to 80 %: <= 5 s", scenarios=_OUTAGES, figure="recovery", limit=5.0),
    Target(
        title="burst loss, share of the oracle's goodput: >= 75 %",
        scenarios=_BURSTS,
        figure="utilisation",
        limit=0.75,
        at_least=True,
    ),
    Target(title="burst loss, queue peak: <= 1 s", scenarios=_BURSTS, figure="queue peak", limit=1.0),
    Target(
        title="oscillation 5 s, share of the oracle's goodput: >= 75 %",
        scenarios=("oscillation 5 s",),
        figure="utilisation",
        limit=0.75,
        at_least=True,
    ),
    Target(title="oscillation 5 s, queue peak: <= 1 s", scenarios=("oscillation 5 s",), figure="queue peak", limit=1.0),
)


def scenario_table(found: Mapping[str, Mapping[str, list[Metrics]]], *, seeds: int) -> str:
    """Lay out every scenario and way: the median of the seeds, and the worst in brackets where it differs."""
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
    """Lay out what was to be shown, and whether it was."""
    rows = [["target", "median", "worst", "met"]]
    for target in TARGETS:
        values = target.values(found, way)
        if values:
            met = "yes" if target.is_met(values) else "NO"
            rows.append([target.title, target.shown(median(values)), target.shown(target.worst(values)), met])
    return "\n".join(_columns(rows))


def _cell(figure: str, every: Sequence[Metrics]) -> str:
    title_and_more = (COLUMNS | EVENTS)[figure]
    _, write, more_is_better = title_and_more
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
