"""Output of `arpd simulate`: tables for people, a document for programs."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from arpd.cli.columns import aligned, short_name
from arpd.daemon.compare import WARM_UP_S, events, summarize
from arpd.daemon.scenario import Moment
from arpd.model.endpoints import Direction
from arpd.model.quantities import format_duration, format_number, format_rate, format_share, format_size, printable
from arpd.report.wording import count

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from arpd.daemon.compare import Comparison, LinkEvent, Summary
    from arpd.daemon.scenario import ScenarioResult
    from arpd.model.settings import Settings
    from arpd.sim.link import LinkModel
    from arpd.sim.result import TopicResult
    from arpd.sim.robot import SimTopic
    from arpd.sim.trace import LinkTrace

_MBIT = 1e6 / 8  # bytes
_WAYS = ("arpd", "without", "oracle")
_WAY = max(map(len, _WAYS))
_MOST_EVENTS = 25


@dataclass(frozen=True, kw_only=True, slots=True)
class Asked:
    """The request, read and checked.

    Parameters
    ----------
    config : file of the configuration; None = the settings are the demo robot's, too
    trace : the link, as long as the run
    duration_s : length of the run (s)
    is_demo : True for the demo robot, when the configuration names no topics
    """

    config: Path | None
    settings: Settings
    trace: LinkTrace
    duration_s: float
    seed: int
    model: LinkModel
    robot: tuple[SimTopic, ...]
    is_demo: bool


def comparison_tables(asked: Asked, comparison: Comparison) -> str:
    """Lay out the three ways side by side: overall, per topic, and what arpd did when."""
    found = events(comparison.arpd)
    rates: dict[str, Callable[[TopicResult], str]] = {
        "delivered Hz": lambda topic: format_number(topic.received / asked.duration_s),
        "lost %": lambda topic: f"{100 * topic.loss_ratio:.2f}",
    }
    delays: dict[str, Callable[[TopicResult], str]] = {
        "latency p50, ms": lambda topic: _milliseconds(topic.latency_p50_s),
        "latency p99, ms": lambda topic: _milliseconds(topic.latency_p99_s),
        "age p99, ms": lambda topic: _milliseconds(topic.age_p99_s),
    }
    lines = [
        *_head(asked, comparison),
        "",
        *_overall(_summaries(asked, comparison)),
        "",
        *_topics(asked, comparison, rates),
        "",
        *_topics(asked, comparison, delays),
        "",
        f"what arpd did ({len(found)} events)" if found else "arpd made no plan",
        *aligned([_event_cells(event) for event in found[:_MOST_EVENTS]] or [("",)], words=2),
    ]
    if len(found) > _MOST_EVENTS:
        lines.append(f"  and {len(found) - _MOST_EVENTS} more; --json has all")
    return "\n".join(lines).rstrip()


def comparison_document(asked: Asked, comparison: Comparison) -> dict[str, Any]:
    """Return everything as JSON, the course by columns; ``null`` = it does not exist, or never ended."""
    return {
        "config": None if asked.config is None else str(asked.config),
        "trace": asked.trace.name,
        "duration_s": asked.duration_s,
        "seed": asked.seed,
        "warm_up_s": WARM_UP_S,
        "link": {
            name: value for name, value in asdict(asked.model).items() if name not in {"losses", "outages", "bursts"}
        },
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
                "topics": [_topic_document(topic, asked.duration_s) for topic in comparison.ways[way].topics],
                "course": _course(comparison.ways[way]),
            }
            for way, summary in _summaries(asked, comparison).items()
        },
        "events": [asdict(event) for event in events(comparison.arpd)],
    }


def _summaries(asked: Asked, comparison: Comparison) -> dict[str, Summary]:
    return {
        way: summarize(result, start_s=WARM_UP_S, end_s=asked.duration_s) for way, result in comparison.ways.items()
    }


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
    rates = [moment.truth_bytes_per_second for moment in comparison.arpd.moments]
    low, mean, high = (format_rate(rate) for rate in (min(rates), sum(rates) / len(rates), max(rates)))
    model = asked.model
    about = [f"delay {format_duration(model.delay_s)}", f"queue {format_size(model.queue_bytes)}"]
    if not model.pushes_back:
        about.append("bottleneck between the hosts")
    if model.loss:
        about.append(f"loss {format_share(model.loss)}")
    if model.losses:
        about.append("loss as recorded")
    if model.packet_overhead_s:
        most = f"at most {model.aggregate_packets} packets" if model.aggregate_packets > 1 else "one packet"
        about.append(f"{format_duration(model.packet_overhead_s)} per transmission of {most}")
    published = sum(topic.payload_bytes * topic.rate_hz for topic in asked.robot)
    robot = f"{count(len(asked.robot), 'topic')} with {format_rate(published)} of payload"
    if asked.config is None:
        robot = f"the demo robot, {robot}; --config names another"
    elif asked.is_demo:
        config = printable(str(asked.config), longest=200)
        robot = f"the demo robot, {robot}; no topic in {config} has a payload and a source_rate_hz"
    return [
        f"link     {printable(asked.trace.name)}: {low} to {high}, mean {mean}",
        f"         {', '.join(about)}",
        f"robot    {robot}",
        "ways     arpd; without it (rclpy's defaults, unpaced); arpd with an oracle for its estimator",
        f"runs     {format_duration(asked.duration_s)} each, seed {asked.seed}",
    ]


def _overall(summaries: dict[str, Summary]) -> list[str]:
    best = summaries["oracle"].goodput_bytes_per_second

    def row(title: str, cell: Callable[[Summary], str]) -> tuple[str, ...]:
        return (title, *(cell(summary) for summary in summaries.values()))

    return aligned(
        [
            (f"from {WARM_UP_S:g} s on", *_WAYS),
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
        ],
        words=0,
    )


def _topics(asked: Asked, comparison: Comparison, blocks: dict[str, Callable[[TopicResult], str]]) -> list[str]:
    """Lay out numbers per topic over the whole run, three ways per number."""

    def three(cells: Iterable[str]) -> str:
        return " " + " ".join(cell.rjust(_WAY) for cell in cells)

    rows = [("", "source", *blocks), ("topic, whole run", "Hz", *(three(_WAYS) for _ in blocks))]
    for topic, *results in zip(asked.robot, *(way.topics for way in comparison.ways.values()), strict=True):
        arrow = " (to robot)" if topic.direction is Direction.ACTUATION else ""
        cells = (three(map(cell, results)) for cell in blocks.values())
        rows.append((short_name(topic.name) + arrow, format_number(topic.rate_hz, digits=4), *cells))
    return aligned(rows, words=0)


def _event_cells(event: LinkEvent) -> tuple[str, ...]:
    after = event.after_bytes_per_second
    if after is None:
        return ("", f"{event.t_s:.1f} s", event.what, "")
    before = event.before_bytes_per_second
    change = f"{format_rate(before)} -> {format_rate(after)}" if before is not None else f"-> {format_rate(after)}"
    return ("", f"{event.t_s:.1f} s", event.what, change)


def _milliseconds(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    return format_number(seconds * 1e3) if math.isfinite(seconds) else "never"


def _mbit(bytes_per_second: float | None) -> str:
    return "-" if bytes_per_second is None else f"{bytes_per_second / _MBIT:.2f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"
