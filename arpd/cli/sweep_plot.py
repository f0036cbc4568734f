"""A picture of the plan over the link's capacity; needs matplotlib, the extra ``plot``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator, PercentFormatter

from arpd.cli.columns import short_name
from arpd.model.allocation import AllocationStatus
from arpd.model.quantities import format_number, format_share

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from arpd.govern.what_if import OfflinePlan, PlannedTopic
    from arpd.model.allocation import Topic

_MBIT = 1e6 / 8  # bytes
# Twelve colours that can be read as text on white, neighbours far apart.
_COLOURS = (
    *("#1f77b4", "#d95f02", "#2a8a2a", "#c81e1e", "#7a4fb0", "#8c564b"),
    *("#d6409f", "#5a5a5a", "#8a8400", "#0a8f9c", "#1b2f8f", "#a05a00"),
)
_DASHES = ("solid", (0, (4, 2)))  # so that two lines with the same rate show both
_SHADE = "#f6dede"
_LONGEST_NAME = 40
_INCHES_PER_LABEL = 0.21
_LABEL_GAP = 1.35  # of what a label needs
_UNKNOWN_HZ = 1.0  # stands for the rate of a silent topic without a floor

_Style = dict[str, Any]


def draw_sweep(plans: Sequence[OfflinePlan], *, headroom: float, path: Path) -> None:
    """Draw each topic's rate over the capacity, and below it each topic's share of the link, as a PNG.

    Parameters
    ----------
    plans : by rising capacity, all above 0, with the same topics
    headroom : η, the share of the capacity that may be planned, 0..1
    path : PNG to write

    Raises
    ------
    OSError
        If it cannot be written.
    """
    last = plans[-1].topics
    upper_in = max(5.0, _INCHES_PER_LABEL * _LABEL_GAP * len(last))
    figure = Figure(figsize=(12.0, upper_in + 3.8), layout="constrained")
    FigureCanvasAgg(figure)  # draws without a display
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(upper_in, 3.0))
    capacities = [plan.capacity_bytes_per_second / _MBIT for plan in plans]
    # By their demand: small topics at the foot of the stack, those that yield first on top.
    order = sorted(range(len(last)), key=lambda index: last[index].topic.wire_bytes * last[index].topic.desired_rate_hz)
    styles = {index: _style(place) for place, index in enumerate(order)}
    for index in order:
        _draw_rate(upper, capacities, [plan.topics[index] for plan in plans], styles[index])
    _draw_shares(lower, capacities, plans, [(index, styles[index]) for index in order], headroom)
    _decorate(upper, lower, capacities)
    _shade_degraded((upper, lower), capacities, plans)
    upper.set_ylim(*_rate_limits([row.topic for row in last]))
    _label(upper, [(row, styles[index]) for index, row in enumerate(last)], gap=_INCHES_PER_LABEL / upper_in)
    figure.savefig(path, format="png", dpi=120)


def _style(place: int) -> _Style:
    rounds, colour = divmod(place, len(_COLOURS))
    return {"color": _COLOURS[colour], "linestyle": _DASHES[(place + rounds) % len(_DASHES)]}


def _draw_rate(axes: Any, capacities: Sequence[float], rows: Sequence[PlannedTopic], style: _Style) -> None:
    rates = [row.rate_hz or math.nan for row in rows]  # a logarithmic axis has no zero
    axes.plot(capacities, rates, linewidth=1.8, zorder=3, **style)
    floor_hz, colour = rows[0].topic.min_rate_hz, style["color"]
    above = next((i for i, row in enumerate(rows) if not (row.is_at_floor or row.is_below_floor)), -1)
    if floor_hz > 0:
        axes.plot(
            (capacities[0], capacities[above]), (floor_hz, floor_hz), linestyle=":", linewidth=1, color=colour, zorder=2
        )
    full = next((i for i, row in enumerate(rows) if row.has_its_wish), None)
    if full is not None:
        axes.plot(capacities[full], rates[full], marker="o", markersize=5, zorder=4, color=colour, clip_on=False)


def _draw_shares(
    axes: Any,
    capacities: Sequence[float],
    plans: Sequence[OfflinePlan],
    order: Sequence[tuple[int, _Style]],
    headroom: float,
) -> None:
    axes.stackplot(
        capacities,
        [[plan.topics[index].allocation.share for plan in plans] for index, _ in order],
        colors=[style["color"] for _, style in order],
        edgecolor="white",
        linewidth=0.4,
        alpha=0.85,
        zorder=2,
    )
    axes.axhline(headroom, color="black", linewidth=1, linestyle="--", zorder=3)
    axes.annotate(
        f"{format_share(headroom)} may be planned (headroom)",
        (capacities[-1], headroom),
        xytext=(-4, 4),
        textcoords="offset points",
        ha="right",
        fontsize=9,
    )


def _shade_degraded(panels: Sequence[Any], capacities: Sequence[float], plans: Sequence[OfflinePlan]) -> None:
    """Shade the capacities at which floors give way."""
    degraded = [i for i, plan in enumerate(plans) if plan.allocation.status is AllocationStatus.DEGRADED]
    if degraded:
        for axes in panels:
            axes.axvspan(capacities[0], capacities[degraded[-1]], color=_SHADE, zorder=0, linewidth=0)


def _label(axes: Any, ends: Sequence[tuple[PlannedTopic, _Style]], *, gap: float) -> None:
    """Write each topic's name beside the right end of its line, apart from the others.

    Parameters
    ----------
    gap : height of a label (share of the panel)
    """
    low, high = (math.log(limit) for limit in axes.get_ylim())
    rising = sorted(ends, key=lambda end: (_end_hz(end[0]), end[0].topic.name))
    heights = [(math.log(_end_hz(row)) - low) / (high - low) for row, _ in rising]
    for (row, style), height in zip(rising, _apart(heights, gap), strict=True):
        axes.annotate(
            _caption(row.topic),
            (1.0, _end_hz(row)),
            xycoords=axes.get_yaxis_transform(),
            xytext=(1.05, height),
            textcoords="axes fraction",
            va="center",
            fontsize=9,
            color=style["color"],
            parse_math=False,
            arrowprops={
                "arrowstyle": "-",
                "color": style["color"],
                "linewidth": 0.8,
                "relpos": (0, 0.5),
                "shrinkA": 1,
                "shrinkB": 1,
            },
            annotation_clip=False,
        )


def _end_hz(row: PlannedTopic) -> float:
    """Return the rate at the end of the topic's line; a paused topic has its floor or its desired rate (Hz)."""
    return row.rate_hz or row.topic.min_rate_hz or row.topic.desired_rate_hz or _UNKNOWN_HZ


def _apart(heights: Sequence[float], gap: float) -> list[float]:
    """Move rising heights apart by at least ``gap``, as little as possible, within 0..1 where they fit."""
    moved: list[float] = []
    for height in heights:
        moved.append(max(height, moved[-1] + gap if moved else 0.0))
    ceiling = 1.0
    for i in reversed(range(len(moved))):
        moved[i] = min(moved[i], ceiling)
        ceiling = moved[i] - gap
    return moved


def _caption(topic: Topic) -> str:
    floor, desired = format_number(topic.min_rate_hz), format_number(topic.desired_rate_hz)
    rates = desired if floor == desired else f"{floor} to {desired}"
    return f"{short_name(topic.name, longest=_LONGEST_NAME)}  {rates} Hz, weight {format_number(topic.weight)}"


def _rate_limits(topics: Sequence[Topic]) -> tuple[float, float]:
    """Return limits that show every floor and every desired rate; a rate far below any floor is nearly a pause (Hz)."""
    highs = [topic.desired_rate_hz or _UNKNOWN_HZ for topic in topics]
    lows = [topic.min_rate_hz or high / 10 for topic, high in zip(topics, highs, strict=True)]
    return min(lows) / 2.5, max(highs) * 1.6


def _decorate(upper: Any, lower: Any, capacities: Sequence[float]) -> None:
    upper.set(xscale="log", yscale="log", ylabel="rate (Hz)", title="What arpd would plan, by what the link carries")
    upper.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    upper.yaxis.set_minor_locator(NullLocator())
    upper.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    marks = (
        Line2D([], [], color="grey", marker="o", linestyle="none", markersize=5, label="from here on all it desires"),
        Line2D([], [], color="grey", linestyle=":", linewidth=1, label="its floor"),
        Patch(color=_SHADE, label="floors give way"),
    )
    upper.legend(handles=marks, loc="lower right", fontsize=9, frameon=True, framealpha=0.9, edgecolor="none")
    lower.set(xlabel="capacity (Mbit/s)", ylabel="share of the link's time", ylim=(0, 1))
    lower.set_xlim(capacities[0], capacities[-1])
    lower.yaxis.set_major_formatter(PercentFormatter(1.0))
    lower.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    lower.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    lower.xaxis.set_minor_locator(NullLocator())
    for axes in (upper, lower):
        axes.set_axisbelow(True)
        axes.grid(visible=True, color="0.9", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
