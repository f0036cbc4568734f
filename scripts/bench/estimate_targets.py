"""The targets of `scripts/bench/estimate.py`, and its report, beside what `adapt.py` measured on the real link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.adapt_targets import estimates_of
from scripts.bench.estimate_grid import grid_report
from scripts.bench.estimate_scenarios import FALLS
from scripts.bench.record import described
from scripts.bench.report import Column, about, paragraphs, percent, table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Scenarios = Mapping[str, Mapping[str, Sequence[Mapping[str, float | None]]]]  # None = never

ARPD, BOUND, FLUID = "arpd", "bound", "fluid"
THROUGHPUT = ("average", "maximum")

_PERCENT, _FINE_PERCENT = ("%", 100.0, ".1f"), ("%", 100.0, ".2f")
_SECONDS, _MILLISECONDS = ("s", 1.0, ".2f"), ("ms", 1e3, ".0f")
_COUNT, _RATE, _TIMES = ("", 1.0, ".0f"), ("/min", 1.0, ".1f"), ("", 1.0, ".2f")
#: Figures of every scenario, then those of events: unit, factor and format.
FIGURES = {
    "error p50": _PERCENT,
    "error p90": _PERCENT,
    "utilisation": _PERCENT,
    "carried": _PERCENT,
    "queue p50": _MILLISECONDS,
    "queue p95": _MILLISECONDS,
    "queue p99": _MILLISECONDS,
    "queue peak": _SECONDS,
    "queue p99 / bound": _TIMES,
    "lost": _COUNT,
    "lost beyond bound": _COUNT,
    "levels": _RATE,
    "swaps": _RATE,
    "measuring": _FINE_PERCENT,
}
EVENTS = {
    "reaction, estimate": _SECONDS,
    "reaction, budget": _SECONDS,
    "queue over bound": _MILLISECONDS,
    "rise, estimate": _SECONDS,
    "rise, goodput": _SECONDS,
    "carried / fluid": _PERCENT,
    "queue p95 / fluid": _TIMES,
    "near zero, queue": _SECONDS,
    "closed within": _SECONDS,
    "queue in": _SECONDS,
    "queue in over bound": _SECONDS,
    "queue after": _SECONDS,
    "recovery": _SECONDS,
}
_MORE_IS_BETTER = frozenset({"utilisation", "carried", "carried / fluid"})


@dataclass(frozen=True, slots=True)
class Target:
    """A limit for one figure.

    Parameters
    ----------
    limit : for the median, and for the worst seed unless ``worst_limit`` is given
    scenarios : their values are one set; none = all scenarios
    real : name of the figure among `adapt_estimate.py`'s, and the links whose runs count; none = all links
    """

    what: str
    figure: str
    limit: float
    scenarios: tuple[str, ...] = ()
    worst_limit: float | None = None
    real: tuple[str, ...] = ()

    def values(self, scenarios: Scenarios, way: str) -> list[float]:
        """Return one value per scenario and seed, of the scenarios that were played; never is infinite."""
        return [
            value
            for name in self.scenarios or tuple(scenarios)
            for value in _known(self.figure, scenarios.get(name, {}).get(way, []))
        ]

    def worst(self, values: Sequence[float]) -> float:
        return _worst(self.figure, values)

    def is_met(self, values: Sequence[float]) -> bool:
        """Return whether the median keeps the limit, and the worst seed its own."""
        worst_limit = self.limit if self.worst_limit is None else self.worst_limit
        return self.keeps(median(values), self.limit) and self.keeps(self.worst(values), worst_limit)

    def keeps(self, value: float, limit: float) -> bool:
        """Return whether a value keeps a limit."""
        return value >= limit if self.figure in _MORE_IS_BETTER else value <= limit

    @property
    def limits(self) -> str:
        sign = "≥" if self.figure in _MORE_IS_BETTER else "≤"
        text = f"{sign} {_written(self.figure, self.limit)}"
        return text if self.worst_limit is None else f"{text}, worst {sign} {_written(self.figure, self.worst_limit)}"

    def outcome(self, values: Sequence[float]) -> str:
        """Return whether it is met, and if not, who misses."""
        if self.is_met(values):
            return "✓"
        return "✗ worst seed" if self.keeps(median(values), self.limit) else "✗ median"


_DROP = ("fall 20 to 5", "fall 20 to 5, unseen")
_DEEP_DROP = ("fall 5 to 1", "fall 5 to 1, unseen")
_FALLS = (*FALLS, "fall 20 to 5, unseen")
_HOLES = ("fall 20 to 5, local maps", "fall 20 to 5, download")
_RISE = ("rise 5 to 20",)
_STEADY = ("steady 20", "steady 5")
_OUTAGES = ("outages, lost", "outages, stalled")
_BURSTS = ("bursts, all lost", "bursts, half lost")
_OSCILLATIONS = ("oscillation 2 s", "oscillation 5 s", "oscillation 8 s")
_CELLULAR = ("cellular up", "cellular down")
_STEADY_LINKS = ("steady-20", "steady-5")

TARGETS = (
    Target("falls to 0.3 to 0.95, estimate", "reaction, estimate", 0.6, _FALLS, 1.5),
    Target("falls to 0.3 to 0.95, queue p50 over the bound's", "queue over bound", 0.015, _FALLS),
    Target("20→5, estimate", "reaction, estimate", 0.6, _DROP, 1.5, ("reaction_s", "step-down")),
    Target("20→5, budget", "reaction, budget", 0.6, _DROP, 1.5, ("budget_s", "step-down")),
    Target("20→5 beside local maps or a download, estimate", "reaction, estimate", 0.6, _HOLES, 1.5),
    Target("20→5, queue peak", "queue peak", 0.6, (*_DROP, *_HOLES), real=("peak_queue_s", "step-down")),
    Target("5→1, queue peak", "queue peak", 1.0, _DEEP_DROP),
    Target("5→20, estimate at 80 %", "rise, estimate", 1.0, _RISE, real=("rise_s", "step-up")),
    Target("5→20, goodput at 80 %", "rise, goodput", 1.0, _RISE),
    Target("steady, error p90", "error p90", 0.10, _STEADY, real=("error_p90", *_STEADY_LINKS)),
    Target("steady, share of the bound's goodput", "utilisation", 0.95, _STEADY),
    Target("steady, plans", "levels", 0.2, _STEADY, real=("plans_per_minute", *_STEADY_LINKS)),
    Target("noisy, plans", "levels", 1.0, ("noisy",)),
    Target("any scenario, plans", "levels", 6.0),
    Target("any scenario, probes and reports of capacity", "measuring", 0.01, real=("measuring",)),
    Target("outage, budget closed", "closed within", 0.5, _OUTAGES, real=("closed_s", "outage")),
    # A delay above 100 ms is a queue: docs/design.md, The estimator.
    Target("outage that loses, no queue built", "queue in", 0.1, ("outages, lost",)),
    # Until the budget is 0, samples queue: 0.85 of the link for 0.3 s without a ping or a report.
    Target("outage that stalls, queue over the bound's", "queue in over bound", 0.26, ("outages, stalled",)),
    Target("outage, recovery to 80 %", "recovery", 5.0, _OUTAGES, real=("recovery_s", "outage")),
    Target("near zero, queue", "near zero, queue", 2.0, ("near zero",)),
    Target("burst loss, share of the bound's goodput", "utilisation", 0.75, _BURSTS),
    Target("burst loss, queue peak", "queue peak", 1.0, _BURSTS),
    Target("oscillations, share of the bound's goodput", "utilisation", 0.92, _OSCILLATIONS),
    Target("oscillations, queue p99 over the bound's, times", "queue p99 / bound", 1.5, _OSCILLATIONS),
    Target("cellular, carried of what the fluid carries", "carried / fluid", 0.85, _CELLULAR),
    Target("cellular, queue p95 over the fluid's, times", "queue p95 / fluid", 1.3, _CELLULAR),
    Target("walk, samples lost beyond the bound's", "lost beyond bound", 0.0, ("walk",)),
)


def report(estimate: dict[str, Any], adapt: dict[str, Any] | None = None) -> str:
    """Return every target beside the figures, the estimates from throughput alone, and the grid's worst cells."""
    scenarios: Scenarios = estimate["scenarios"]
    judged = [(target, values) for target in TARGETS if (values := target.values(scenarios, ARPD))]
    met = sum(target.is_met(values) for target, values in judged)
    columns: list[Column] = [
        ("", lambda row: row[0].what),
        ("target", lambda row: row[0].limits),
        ("simulated", lambda row: _middle_and_worst(row[0].figure, row[1])),
        ("", lambda row: row[0].outcome(row[1])),
    ]
    text = about(
        estimate, f"`scripts/bench/estimate.py` in virtual time, {estimate['seeds']} seeds, the worst in brackets"
    )
    if adapt is not None:
        real = estimates_of(adapt)
        columns.append(("real link", lambda row: _middle_and_worst(row[0].figure, _real(row[0], real["runs"]))))
        text += f" The real link: {real['what']} ({described(real)})."
    return paragraphs(
        text,
        f"Targets: {met} of {len(judged)} met, simulated." if judged else "",
        table(judged, *columns) if judged else "",
        _throughput(scenarios),
        grid_report(estimate.get("grid", [])),
    )


def scenario_tables(document: dict[str, Any]) -> str:
    """Return the figures of every scenario and way, and those of events; the worst seed in brackets."""
    played = [(name, way, every) for name, ways in document["scenarios"].items() for way, every in ways.items()]
    eventful = [row for row in played if any(figure in EVENTS for figure in row[2][0])]
    return paragraphs(
        *(_figures_of(rows, figures) for rows, figures in ((played, FIGURES), (eventful, EVENTS)) if rows)
    )


def _figures_of(rows: Sequence[tuple[str, str, Any]], figures: Mapping[str, Any]) -> str:
    shown = [figure for figure in figures if any(figure in metrics for *_, every in rows for metrics in every)]
    columns: list[Column] = [
        (figure, lambda row, figure=figure: _middle_and_worst(figure, _known(figure, row[2]))) for figure in shown
    ]
    return table(rows, ("scenario", 0), ("way", 1), *columns)


def _known(figure: str, every: Sequence[Mapping[str, float | None]]) -> list[float]:
    found = [metrics[figure] for metrics in every if figure in metrics]
    return [math.inf if value is None else value for value in found]


def _worst(figure: str, values: Sequence[float]) -> float:
    return min(values) if figure in _MORE_IS_BETTER else max(values)


def _written(figure: str, value: float) -> str:
    unit, factor, spec = (FIGURES | EVENTS)[figure]
    return f"{factor * value:{spec}} {unit}".rstrip() if math.isfinite(value) else "never"


def _middle_and_worst(figure: str, values: Sequence[float]) -> str | None:
    if not values:
        return None
    middle, worst = _written(figure, median(values)), _written(figure, _worst(figure, values))
    return middle if middle == worst else f"{middle} ({worst})"


def _real(target: Target, runs: Sequence[dict[str, Any]]) -> list[float]:
    """Return the target's figure in runs over the real link."""
    if not target.real:
        return []
    name, *links = target.real
    every = [dict(run["estimate"]) for run in runs if not links or run["link"] in links]
    for figures in every:
        if "probe_share" in figures:
            figures["measuring"] = figures["probe_share"] + figures["report_share"]
    return _known(name, every)


def _throughput(scenarios: Scenarios) -> str:
    """Compare with estimates from throughput alone, over the scenarios that they play."""
    ways = (ARPD, *THROUGHPUT)
    common = {name: played for name, played in scenarios.items() if {*ways} <= played.keys()}
    if not common:
        return ""

    def over(figure: str, of_all: Callable[[Sequence[float]], float]) -> Callable[[str], float]:
        return lambda way: of_all([median(_known(figure, played[way])) for played in common.values()])

    return paragraphs(
        f"With estimates from throughput alone, over {len(common)} scenarios ({', '.join(common)}); maximum: over 8 s.",
        table(
            ways,
            ("", str),
            ("goodput of the bound's %", over("utilisation", median), percent),
            ("longest queue", lambda way: _written("queue peak", over("queue peak", max)(way))),
        ),
    )
