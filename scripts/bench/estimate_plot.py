"""The picture of `scripts/bench/estimate.py`: the link of every scenario, and each way's estimate of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from scripts.bench.estimate_scenarios import MBIT, SCENARIOS
from scripts.bench.picture import picture

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from arpd.daemon.scenario import ScenarioResult

_COLUMNS = 4
_STYLES = {
    "average": ("#d95f02", "average of throughput, 1 s"),
    "maximum": ("#2a8a2a", "maximum of throughput, 8 s"),
    "arpd": ("#1f77b4", "arpd"),
}


def draw(pictures: Mapping[str, Mapping[str, ScenarioResult]], path: Path) -> None:
    """Draw one panel per scenario, with the runs of the first seed."""
    columns = min(_COLUMNS, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    handles: dict[str, Any] = {}
    with picture(path, rows, columns, figsize=(4.2 * columns, 2.6 * rows + 0.6), squeeze=False) as (figure, grid):
        panels = grid.flat
        for (name, results), axes in zip(pictures.items(), panels, strict=False):
            handles |= _draw_scenario(name, results, axes)
        for axes in list(panels):
            axes.set_visible(False)  # the rest of the grid
        figure.supxlabel("time (s)", fontsize=10)
        figure.supylabel("capacity (Mbit/s)", fontsize=10)
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4, frameon=False, fontsize=10)


def _draw_scenario(name: str, results: Mapping[str, ScenarioResult], axes: Any) -> dict[str, Any]:
    """Draw one panel; return its lines by their names in the legend."""
    handles = {}
    moments = next(iter(results.values())).moments
    times = [moment.t_s for moment in moments]
    truth = [moment.truth_bytes_per_second / MBIT for moment in moments]
    axes.fill_between(times, truth, step="post", color="0.75", alpha=0.4, linewidth=0)
    (handles["the link"],) = axes.step(times, truth, where="post", color="0.55", linewidth=1.0)
    for start_s, end_s in SCENARIOS[name].outages:
        axes.axvspan(start_s, end_s, color="#f6dede", linewidth=0)
    for way, (colour, title) in _STYLES.items():
        if way in results:
            believed = [(m.estimate_bytes_per_second or math.nan) / MBIT for m in results[way].moments]
            (handles[title],) = axes.plot(times, believed, color=colour, linewidth=1.2)
    axes.set_title(name, fontsize=10, loc="left")
    axes.set_xlim(0.0, times[-1])
    axes.set_ylim(0.0, 1.3 * max(truth))
    axes.grid(visible=True, color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    return handles
