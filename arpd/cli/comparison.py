"""Output of `arpd simulate`: tables for people, a document for programs."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from rich.text import Text

from arpd.cli.output import FittedTable, show
from arpd.daemon.compare import WARM_UP_S, events, summarize
from arpd.daemon.scenario import Moment
from arpd.model.endpoints import Direction
from arpd.model.quantities import format_duration, format_number, format_rate, format_size, printable
from arpd.report.wording import count

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from arpd.daemon.compare import Comparison, LinkEvent, Summary
    from arpd.daemon.scenario import ScenarioResult
    from arpd.sim.link import LinkModel
    from arpd.sim.result import TopicResult
    from arpd.sim.robot import SimTopic
    from arpd.sim.trace import LinkTrace

_MBIT = 1e6 / 8  # bytes
_MOST_EVENTS = 25


@dataclass(frozen=True, kw_only=True, slots=True)
class Asked:
    """The request, read and checked.

    Parameters
    ----------
    config : file of the configuration; None = the demo robot's
    trace : the link, as long as the run
    duration_s : length of the run (s)
    is_demo : True for the demo robot, when the configuration names no topics
    """

    config: Path | None
    trace: LinkTrace
    duration_s: float
    seed: int
    model: LinkModel
    robot: tuple[SimTopic, ...]
    is_demo: bool


def show_comparison(asked: Asked, comparison: Comparison) -> None:
    """Print the three ways side by side: overall, per topic, and what arpd did when."""
    rates: dict[str, Callable[[TopicResult], str]] = {
        "DELIVERED, HZ": lambda topic: format_number(topic.received / asked.duration_s),
        "LOST, %": lambda topic: f"{100 * topic.loss_ratio:.2f}",
    }
    delays: dict[str, Callable[[TopicResult], str]] = {
        "LATENCY P50, MS": lambda topic: _milliseconds(topic.latency_p50_s),
        "LATENCY P99, MS": lambda topic: _milliseconds(topic.latency_p99_s),
        "AGE P99, MS": lambda topic: _milliseconds(topic.age_p99_s),
    }
    found = events(comparison["arpd"])
    what_it_did = [("", "WHAT ARPD DID", "CAPACITY"), *map(_event_cells, found[:_MOST_EVENTS])]
    show(*map(Text, _head(asked, comparison)), "", _overall(_summaries(asked, comparison)))
    show("", _topics(asked, comparison, rates), "", _topics(asked, comparison, delays))
    show("", FittedTable(rows=what_it_did, words=frozenset(what_it_did[0])) if found else "arpd made no plan")
    if len(found) > _MOST_EVENTS:
        show(f"and {len(found) - _MOST_EVENTS} more; --json has all")


def comparison_document(asked: Asked, comparison: Comparison) -> dict[str, Any]:
    """Return everything as JSON, the course by columns; ``null`` = it does not exist, or never ended."""
    return {
        "config": None if asked.config is None else str(asked.config),
        "trace": asked.trace.name,
        "duration_s": asked.duration_s,
        "seed": asked.seed,
        "warm_up_s": WARM_UP_S,
        "link": {name: value for name, value in asdict(asked.model).items() if name not in {"losses", "outages"}},
        "robot": {
            "is_demo": asked.is_demo,
            "topics": [
                {
                    "topic": topic.name,
                    "link_topic": topic.prefix + topic.name,
                    "payload_bytes": topic.payload_bytes,
                    "source_rate_hz": topic.rate_hz,
                    "direction": str(topic.direction),
                }
                for topic in asked.robot
            ],
        },
        "ways": {
            way: {
                "summary": {name: _value(figure) for name, figure in asdict(summary).items()},
                "topics": [_topic_document(topic, asked.duration_s) for topic in comparison[way].topics],
                "course": _course(comparison[way]),
            }
            for way, summary in _summaries(asked, comparison).items()
        },
        "events": [asdict(event) for event in events(comparison["arpd"])],
    }


def _summaries(asked: Asked, comparison: Comparison) -> dict[str, Summary]:
    return {way: summarize(result, start_s=WARM_UP_S, end_s=asked.duration_s) for way, result in comparison.items()}


def _topic_document(topic: TopicResult, duration_s: float) -> dict[str, Any]:
    return {
        **{name: _value(figure) for name, figure in asdict(topic).items()},
        "lost": topic.lost,
        "loss_ratio": topic.loss_ratio,
        "withheld_ratio": topic.withheld_ratio,
        "delivered_rate_hz": topic.received / duration_s,
    }


def _course(result: ScenarioResult) -> dict[str, list[Any]]:
    columns = {
        field.name: [_value(getattr(moment, field.name)) for moment in result.moments] for field in fields(Moment)
    }
    return {name: column for name, column in columns.items() if any(value is not None for value in column)}


def _value(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _head(asked: Asked, comparison: Comparison) -> list[str]:
    rates = [moment.truth_bytes_per_second for moment in comparison["arpd"].moments]
    low, mean, high = (format_rate(rate) for rate in (min(rates), sum(rates) / len(rates), max(rates)))
    published = sum(topic.payload_bytes * topic.rate_hz for topic in asked.robot)
    robot = f"{count(len(asked.robot), 'topic')} with {format_rate(published)} of payload"
    if asked.is_demo:
        why = "no configuration has a payload and a source_rate_hz" if asked.config else "--config names another"
        robot = f"the demo robot, {robot}; {why}"
    model = f"delay {format_duration(asked.model.delay_s)}, queue {format_size(asked.model.queue_bytes)}"
    return [
        f"link     {printable(asked.trace.name)}: {low} to {high}, mean {mean}; {model}",
        f"robot    {robot}",
        "ways     arpd; without it (rclpy's defaults, unpaced); arpd with an oracle for its estimator",
        f"runs     {format_duration(asked.duration_s)} each, seed {asked.seed}",
    ]


def _overall(summaries: dict[str, Summary]) -> FittedTable:
    best = summaries["oracle"].goodput_bytes_per_second

    def row(title: str, cell: Callable[[Summary], str]) -> tuple[str, ...]:
        return (title, *(cell(summary) for summary in summaries.values()))

    rows = [
        (f"FROM {WARM_UP_S:g} S ON", *(way.upper() for way in summaries)),
        row("payload delivered, Mbit/s", lambda s: _mbit(s.goodput_bytes_per_second)),
        row("of the oracle's, %", lambda s: f"{100 * s.goodput_bytes_per_second / best:.1f}" if best else "-"),
        row("of the link carried, %", lambda s: _percent(s.carried_share)),
        row("budget, mean, Mbit/s", lambda s: _mbit(s.budget_mean_bytes_per_second)),
        row("longest queue, ms", lambda s: _milliseconds(s.queue_peak_s)),
        row("99 % of queues below, ms", lambda s: _milliseconds(s.queue_p99_s)),
        row("estimate off by, median, %", lambda s: _percent(s.error_median)),
        row("estimate off by, p90, %", lambda s: _percent(s.error_p90)),
        row("plans per minute", lambda s: f"{s.plans_per_minute:.1f}"),
        row("QoS swaps per minute", lambda s: f"{s.swaps_per_minute:.1f}"),
        row("probes and reports, % of link", lambda s: f"{100 * s.measuring_share:.2f}"),
    ]
    return FittedTable(rows=rows)


def _topics(asked: Asked, comparison: Comparison, figures: dict[str, Callable[[TopicResult], str]]) -> FittedTable:
    """Lay out figures per topic over the whole run, three ways each."""
    ways = comparison
    titles = [f"{figure if way == 'arpd' else ''}\n{way}" for figure in figures for way in ways]
    rows = [("TOPIC, WHOLE RUN", "SOURCE\nHZ", *titles)]
    for topic, *results in zip(asked.robot, *(way.topics for way in ways.values()), strict=True):
        arrow = " (to robot)" if topic.direction is Direction.ACTUATION else ""
        cells = (cell(result) for cell in figures.values() for result in results)
        rows.append((printable(topic.name) + arrow, format_number(topic.rate_hz, digits=4), *cells))
    return FittedTable(rows=rows)


def _event_cells(event: LinkEvent) -> tuple[str, str, str]:
    after, before = event.after_bytes_per_second, event.before_bytes_per_second
    change = "" if after is None else f"{'' if before is None else format_rate(before)} -> {format_rate(after)}".strip()
    return f"{event.t_s:.1f} s", event.what, change


def _milliseconds(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    return format_number(seconds * 1e3) if math.isfinite(seconds) else "never"


def _mbit(bytes_per_second: float | None) -> str:
    return "-" if bytes_per_second is None else f"{bytes_per_second / _MBIT:.2f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"
