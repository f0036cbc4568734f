"""The tables of `scripts/bench/estimate.py`: every scenario and way, and the targets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from arpd.cli.columns import aligned
from scripts.bench.estimate_scenarios import FALLS
from scripts.bench.report import percent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from scripts.bench.estimate_metrics import Metrics

_BURSTS = ("bursts, all lost", "bursts, half lost")
_DROP = ("fall 20 to 5", "fall 20 to 5, unseen")
_DEEP_DROP = ("fall 5 to 1", "fall 5 to 1, unseen")
_FALLS = (*FALLS, "fall 20 to 5, unseen")
_HOLES = ("fall 20 to 5, local maps", "fall 20 to 5, download")
_OUTAGES = ("outages, lost", "outages, stalled")
_OSCILLATIONS = ("oscillation 2 s", "oscillation 5 s", "oscillation 8 s")
_STEADY = ("steady 20", "steady 5")


def _seconds(value: float) -> str:
    return f"{value:.2f}"


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.0f}"


def _count(value: float) -> str:
    return f"{value:.1f}"


def _whole(value: float) -> str:
    return f"{value:.0f}"


def _times(value: float) -> str:
    return f"{value:.2f}"


_UNITS: dict[Callable[[float], str], str] = {_seconds: "s", _milliseconds: "ms", percent: "%"}
_Column = tuple[str, "Callable[[float], str]", bool]

#: figure → column title, format, and whether more is better
COLUMNS: dict[str, _Column] = {
    "error p50": ("error p50 %", percent, False),
    "error p90": ("error p90 %", percent, False),
    "utilisation": ("utilised %", percent, True),
    "carried": ("carried %", percent, True),
    "queue p50": ("queue p50 ms", _milliseconds, False),
    "queue p95": ("p95 ms", _milliseconds, False),
    "queue p99": ("p99 ms", _milliseconds, False),
    "queue peak": ("queue peak s", _seconds, False),
    "lost": ("lost", _whole, False),
    "levels": ("levels /min", _count, False),
    "swaps": ("swaps /min", _count, False),
    "measuring": ("probes+reports %", lambda value: f"{100 * value:.2f}", False),
}
EVENTS: dict[str, _Column] = {
    "reaction, estimate": ("reaction, estimate s", _seconds, False),
    "reaction, budget": ("reaction, budget s", _seconds, False),
    "queue over bound": ("queue over bound ms", _milliseconds, False),
    "rise, estimate": ("rise, estimate s", _seconds, False),
    "rise, goodput": ("rise, goodput s", _seconds, False),
    "queue p99 / bound": ("queue p99 / bound", _times, False),
    "carried / fluid": ("carried / fluid %", percent, True),
    "queue p95 / fluid": ("queue p95 / fluid", _times, False),
    "lost beyond bound": ("lost beyond bound", _whole, False),
    "near zero, queue": ("near zero, queue s", _seconds, False),
    **{
        name: (f"{name} s", _seconds, False)
        for name in ("closed within", "queue in", "queue in over bound", "queue after", "recovery")
    },
}
#: Figures of every scenario, which belong into the table of events only where an event is.
_WITH_EVENTS = frozenset({"queue p99 / bound", "lost beyond bound"})


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
        _, write, _ = (COLUMNS | EVENTS)[self.figure]
        return _UNITS.get(write, "")

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
        title="falls to 0.3 to 0.95, estimate: <= 0.6 s median, never > 1.5 s",
        scenarios=_FALLS,
        figure="reaction, estimate",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(
        title="falls to 0.3 to 0.95, queue p50 over the bound's: <= 15 ms",
        scenarios=_FALLS,
        figure="queue over bound",
        limit=0.015,
    ),
    Target(
        title="reaction of the estimate to 20→5: <= 0.6 s median, never > 1.5 s",
        scenarios=_DROP,
        figure="reaction, estimate",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(
        title="reaction of the budget to 20→5: <= 0.6 s median, never > 1.5 s",
        scenarios=_DROP,
        figure="reaction, budget",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(
        title="20→5 beside local maps or a download, estimate: <= 0.6 s median, never > 1.5 s",
        scenarios=_HOLES,
        figure="reaction, estimate",
        limit=0.6,
        worst_limit=1.5,
    ),
    Target(title="queue peak, 20→5: <= 0.6 s", scenarios=(*_DROP, *_HOLES), figure="queue peak", limit=0.6),
    Target(title="queue peak, 5→1: <= 1.0 s", scenarios=_DEEP_DROP, figure="queue peak", limit=1.0),
    Target(
        title="rise 5→20 to 80 %, estimate: <= 1.0 s", scenarios=("rise 5 to 20",), figure="rise, estimate", limit=1.0
    ),
    Target(
        title="rise 5→20 to 80 %, goodput: <= 1.0 s", scenarios=("rise 5 to 20",), figure="rise, goodput", limit=1.0
    ),
    Target(title="steady error, p90: <= 10 %", scenarios=_STEADY, figure="error p90", limit=0.10),
    Target(title="steady, share of the bound's goodput: >= 95 %", scenarios=_STEADY, figure="utilisation", limit=0.95),
    Target(title="levels per minute, steady: <= 0.2", scenarios=_STEADY, figure="levels", limit=0.2),
    Target(title="levels per minute, noisy: <= 1", scenarios=("noisy",), figure="levels", limit=1.0),
    Target(title="levels per minute, any scenario: <= 6", scenarios=(), figure="levels", limit=6.0),
    Target(title="probes and reports, any scenario: <= 1 % of capacity", scenarios=(), figure="measuring", limit=0.01),
    Target(title="outage, budget closed within: <= 0.5 s", scenarios=_OUTAGES, figure="closed within", limit=0.5),
    # A delay above 100 ms is a queue: docs/design.md, The estimator.
    Target(
        title="outage that loses, no queue built: <= 0.1 s", scenarios=("outages, lost",), figure="queue in", limit=0.1
    ),
    Target(
        # Until the budget is 0, samples queue: 0.85 of the link for 0.3 s without a ping or a report.
        title="outage that stalls, queue at its end beyond the bound's: <= 0.26 s",
        scenarios=("outages, stalled",),
        figure="queue in over bound",
        limit=0.26,
    ),
    Target(title="outage, recovery to 80 %: <= 5 s", scenarios=_OUTAGES, figure="recovery", limit=5.0),
    Target(title="near zero, queue: <= 2 s", scenarios=("near zero",), figure="near zero, queue", limit=2.0),
    Target(
        title="burst loss, share of the bound's goodput: >= 75 %", scenarios=_BURSTS, figure="utilisation", limit=0.75
    ),
    Target(title="burst loss, queue peak: <= 1 s", scenarios=_BURSTS, figure="queue peak", limit=1.0),
    Target(
        title="oscillations, share of the bound's goodput: >= 92 %",
        scenarios=_OSCILLATIONS,
        figure="utilisation",
        limit=0.92,
    ),
    Target(
        title="oscillations, queue p99: <= 1.5 of the bound's",
        scenarios=_OSCILLATIONS,
        figure="queue p99 / bound",
        limit=1.5,
    ),
    Target(
        title="cellular, carried of what the fluid carries: >= 85 %",
        scenarios=("cellular up", "cellular down"),
        figure="carried / fluid",
        limit=0.85,
    ),
    Target(
        title="cellular, queue p95: <= 1.3 of the fluid's",
        scenarios=("cellular up", "cellular down"),
        figure="queue p95 / fluid",
        limit=1.3,
    ),
    Target(
        title="walk, samples lost beyond the bound's: <= 0", scenarios=("walk",), figure="lost beyond bound", limit=0.0
    ),
)


def scenario_table(found: Mapping[str, Mapping[str, list[Metrics]]], *, seeds: int) -> str:
    """Return a row per scenario and way: the median of the seeds, and the worst in brackets if it differs."""
    played = [(name, way, every) for name, ways in found.items() for way, every in ways.items()]
    eventful = [row for row in played if any(figure in row[2][0] for figure in EVENTS.keys() - _WITH_EVENTS)]
    lines = [f"median of {seeds} seeds (worst seed)", "", *_figure_table(played, COLUMNS)]
    if eventful:
        lines += ["", *_figure_table(eventful, EVENTS)]
    return "\n".join(lines)


def _figure_table(played: Sequence[tuple[str, str, list[Metrics]]], columns: Mapping[str, _Column]) -> list[str]:
    """Return a row per scenario and way, with the columns that any row has."""
    shown = [figure for figure in columns if any(figure in metrics for *_, every in played for metrics in every)]
    rows = [["scenario", "way", *(columns[figure][0] for figure in shown)]]
    before = ""
    for name, way, every in played:
        rows.append(["" if name == before else name, way, *(_cell(figure, every) for figure in shown)])
        before = name
    return _columns(rows)


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
