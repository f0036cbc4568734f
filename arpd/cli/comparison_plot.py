"""A picture of `arpd simulate`: the link, arpd's estimate and its decisions; needs matplotlib, the extra ``plot``."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from arpd.adapters.sim.result import percentile
from arpd.daemon.compare import events
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from arpd.daemon.compare import Comparison
    from arpd.daemon.scenario import Moment

_MBIT = 1e6 / 8  # bytes
_TRUTH, _ARPD, _WITHOUT, _ORACLE, _LEVEL = "#9aa0a6", "#1f77b4", "#d95f02", "#2a8a2a", "#7a4fb0"
_SHADE = "#f6dede"
_LEAST_QUEUE_MS = 1.0
_AVERAGED_S = 1.0
_MOST_LABELS = 14


def draw_comparison(comparison: Comparison, *, title: str, path: Path) -> None:
    """Draw the course of the link, the budget, the queue and the delivered payload, as a PNG.

    Parameters
    ----------
    comparison : the three runs
    title : name of the link
    path : PNG to write

    Raises
    ------
    OSError
        If it cannot be written.
    """
    figure = Figure(figsize=(12.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)  # draws without a display
    panels = figure.subplots(4, 1, sharex=True, height_ratios=(2.5, 2.0, 2.0, 2.0))
    rate, budget, queue, goodput = panels
    moments = comparison.arpd.moments
    times = [moment.t_s for moment in moments]
    _draw_rate(rate, moments, times)
    _draw_budget(budget, moments, times)
    ways = (
        ("without arpd", comparison.without, _WITHOUT),
        ("oracle", comparison.oracle, _ORACLE),
        ("arpd", comparison.arpd, _ARPD),
    )
    for name, result, colour in ways:
        style = {"color": colour, "linewidth": 1.3, "label": name}
        queue.plot(times, _longest_queues_ms(result.moments), **style)
        goodput.plot(times, _goodput_mbit(result.moments), **style)
    queue.set(yscale="log", ylabel="longest queue (ms)")
    queue.set_ylim(bottom=_LEAST_QUEUE_MS)
    queue.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    goodput.set(ylabel="delivered (Mbit/s)", xlabel="time (s)", xlim=(0.0, times[-1]))
    goodput.set_ylim(bottom=0.0)
    rate.set_title(f"What arpd would have done on {printable(title)}", loc="left", pad=24)
    _mark(comparison, panels)
    for panel in panels:
        panel.set_axisbelow(True)
        panel.grid(visible=True, color="0.9", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
    for panel in panels:
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9, frameon=False)
    figure.savefig(path, format="png", dpi=120)


def _draw_rate(axes: Any, moments: Sequence[Moment], times: Sequence[float]) -> None:
    truth = _draw_link(axes, moments, times)
    axes.plot(times, _rates(moments, "estimate_bytes_per_second"), color=_ARPD, linewidth=1.5, label="arpd's estimate")
    axes.set(ylabel="Mbit/s")
    axes.plot([], [], color="0.6", linewidth=0.8, linestyle=":", label="new plan: QoS swaps")
    # A first estimate far above the link, or a spike of a tenth of a second, must not flatten everything else.
    usual = percentile(truth, 0.98) or 0.0
    axes.set_ylim(0.0, 1.25 * max(usual, 1e-3))


def _draw_budget(axes: Any, moments: Sequence[Moment], times: Sequence[float]) -> None:
    truth = _draw_link(axes, moments, times)
    budgets = _rates(moments, "budget_bytes_per_second")
    axes.plot(times, budgets, color=_ARPD, linewidth=1.3, label="topics may use")
    planned = [moment.level_bytes_per_second if moment.generation else None for moment in moments]
    levels = [math.nan if level is None else level / _MBIT for level in planned]
    axes.step(times, levels, where="post", color=_LEVEL, linewidth=1.5, linestyle=(0, (4, 2)), label="deadlines' level")
    axes.set(ylabel="budget (Mbit/s)")
    axes.set_ylim(0.0, 1.25 * max(percentile(truth, 0.98) or 0.0, 1e-3))


def _draw_link(axes: Any, moments: Sequence[Moment], times: Sequence[float]) -> list[float]:
    """Draw the rate of the link, and return it (Mbit/s)."""
    truth = [moment.truth_bytes_per_second / _MBIT for moment in moments]
    axes.fill_between(times, truth, step="post", color=_TRUTH, alpha=0.25, linewidth=0)
    axes.step(times, truth, where="post", color=_TRUTH, linewidth=1.2, label="link")
    return truth


def _rates(moments: Sequence[Moment], name: str) -> list[float]:
    return [math.nan if (value := getattr(moment, name)) is None else value / _MBIT for moment in moments]


def _longest_queues_ms(moments: Sequence[Moment]) -> list[float]:
    """Return the longest queue in the second before each moment: the queue comes and goes with every large message."""
    window = _window(moments)
    queues = [
        1e3 * moment.queue_delay_s if math.isfinite(moment.queue_delay_s) else math.nan  # a link that never returns
        for moment in moments
    ]
    return [max(_LEAST_QUEUE_MS, *queues[max(0, i - window + 1) : i + 1]) for i in range(len(queues))]


def _goodput_mbit(moments: Sequence[Moment]) -> list[float]:
    """Return the payload delivered in the second before each moment (Mbit/s)."""
    window = _window(moments)
    return [
        (moment.delivered_bytes - before.delivered_bytes) / max(1e-9, moment.t_s - before.t_s) / _MBIT
        for before, moment in zip((*[moments[0]] * window, *moments), moments, strict=False)
    ]


def _window(moments: Sequence[Moment]) -> int:
    return max(1, round(_AVERAGED_S / (moments[1].t_s - moments[0].t_s)))


def _mark(comparison: Comparison, panels: Sequence[Any]) -> None:
    """Draw a line through all panels at each plan, with its cause on top; shade what arpd believed an outage."""
    found = events(comparison.arpd)
    end_s = comparison.arpd.moments[-1].t_s
    outages = [event for event in found if event.what.startswith("outage")]
    for begin, end in pairwise((*outages, None)):
        if begin is not None and begin.what == "outage":
            for panel in panels:
                panel.axvspan(begin.t_s, end.t_s if end else end_s, color=_SHADE, linewidth=0, zorder=0)
    plans = [event for event in found if event.after_bytes_per_second is not None]
    for plan in plans:
        for panel in panels:
            panel.axvline(plan.t_s, color="0.6", linewidth=0.8, linestyle=":", zorder=1)
    if len(plans) <= _MOST_LABELS:
        _write_causes(panels[0], [(plan.t_s, plan.what) for plan in plans], end_s)


def _write_causes(axes: Any, causes: Sequence[tuple[float, str]], end_s: float) -> None:
    free_s, row = -math.inf, 0
    for t_s, cause in causes:
        row = 1 - row if t_s < free_s else 0
        free_s = t_s + 0.06 * end_s
        axes.annotate(
            cause,
            (t_s, 1.0),
            xycoords=axes.get_xaxis_transform(),
            xytext=(2, 2 + 10 * row),
            textcoords="offset points",
            fontsize=8,
            color="0.35",
            annotation_clip=False,
        )
