"""The pictures that repeat the paper's Figure 3, latency, and Figure 4, packet loss, by configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import FIGURES
from scripts.bench.paper_verdict import cells, rounds
from scripts.bench.picture import picture

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from scripts.bench.paper_verdict import Cell

_SHALLOW, _DEEP, _SOLVED = "DEPTH 1", "DEPTH 5000", "DEPTH D"
_STYLES = {_SHALLOW: ("tab:orange", -0.26), _DEEP: ("tab:red", 0.0), _SOLVED: ("tab:blue", 0.26)}
_WIDTH = 0.24


def draw(document: dict[str, Any], path: Path) -> None:
    """Draw both figures into files with -latency and -loss added to the name."""
    for name, title, plot in (
        ("latency", "End-to-end latency, sensor → planner → actuator (ms)", _latency),
        ("loss", "Lost of all samples on the twelve topics (%)", _loss),
    ):
        _draw(document, title, plot, path.with_name(f"{path.stem}-{name}{path.suffix}"))


def _draw(document: dict[str, Any], title: str, plot: Callable[[Any, float, Cell, str], None], path: Path) -> None:
    found = cells(document, FIGURES)
    links = [link["name"] for link in document["links"] if any(cell.link == link["name"] for cell in found)]
    payloads = sorted({cell.payload_bytes for cell in found})
    rates = sorted({cell.deadline_hz for cell in found})
    size = (1.5 + 4.6 * len(payloads), 1.3 + 3.1 * len(links))
    how: dict[str, Any] = {"layout": None, "sharex": True, "sharey": True, "squeeze": False}
    with picture(path, len(links), len(payloads), figsize=size, **how) as (figure, axes):
        for row, link in enumerate(links):
            for column, payload_bytes in enumerate(payloads):
                axis = axes[row][column]
                axis.set_title(f"{link}, {payload_bytes} B", fontsize=10)
                here = [c for c in found if (c.link, c.payload_bytes) == (link, payload_bytes)]
                _panel(axis, here, rates, document, plot)
        for axis in axes[-1]:
            axis.set_xlabel("DEADLINE and publishing rate (Hz), bold: R; below, its D")
        _finish(figure, axes, title, document)


def _panel(axis: Any, found: list[Cell], rates: list[int], document: dict[str, Any], plot: Callable[..., None]) -> None:
    solved = {known["rate_hz"] for known in document["optima"]}
    for cell in found:
        kind = {1: _SHALLOW, 5000: _DEEP}.get(cell.depth, _SOLVED)
        color, shift = _STYLES[kind]
        x = rates.index(cell.deadline_hz) + shift
        if cell.runs:
            plot(axis, x, cell, color)
            if kind is _SOLVED and cell.deadline_hz in solved:
                axis.axvspan(x - _WIDTH / 2, x + _WIDTH / 2, color="tab:blue", alpha=0.13, linewidth=0)
        else:
            axis.text(x, 0.02, "void", rotation=90, transform=axis.get_xaxis_transform(), fontsize=7, color=color,
                      ha="center", va="bottom")  # fmt: skip
    depths = {known[name]: known["depth"] for known in document["optima"] for name in ("rate_hz", "rmax_hz")}
    labels = [rf"$\mathbf{{{rate}}}$" if rate in solved else str(rate) for rate in rates]
    depth_labels = [f"\nD {depths[rate]}" if rate in depths else "" for rate in rates]
    axis.set_xticks(range(len(rates)), [a + b for a, b in zip(labels, depth_labels, strict=True)], fontsize=9)
    axis.set_xlim(-0.6, len(rates) - 0.4)
    axis.grid(axis="y", linewidth=0.4, alpha=0.6)
    axis.set_axisbelow(True)


def _latency(axis: Any, x: float, cell: Cell, color: str) -> None:
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g}")
    p50_s, mean_s, p99_s = (cell.middle("end_to_end", name) for name in ("p50_s", "mean_s", "p99_s"))
    if p50_s is None or mean_s is None or p99_s is None:
        return
    axis.plot([x, x], [p50_s * 1e3, p99_s * 1e3], color=color, linewidth=2.5, alpha=0.55, solid_capstyle="butt")
    axis.plot(x, p50_s * 1e3, marker="_", color=color, markersize=9, markeredgewidth=2)
    axis.plot(x, mean_s * 1e3, marker="d", color=color, markersize=3.5)
    axis.plot(x, p99_s * 1e3, marker="o", color=color, markersize=5)


def _loss(axis: Any, x: float, cell: Cell, color: str) -> None:
    axis.set_yscale("symlog", linthresh=0.01)
    axis.set_ylim(0, 130)
    axis.set_yticks([0, 0.01, 0.1, 1, 10, 100], ["0", "0.01", "0.1", "1", "10", "100"])
    if (lost := cell.lost_ratio) is None:
        return
    if cell.lost:
        axis.bar(x, lost * 100.0, width=_WIDTH, color=color)
    else:
        axis.plot(x, 0.0, marker="o", color=color, markersize=4, clip_on=False)


def _finish(figure: Any, axes: Any, title: str, document: dict[str, Any]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=color, linewidth=5, label=kind) for kind, (color, _) in _STYLES.items()]
    handles[-1].set_label("DEPTH D of Eq. (4); shaded: the optimum (R, D)")
    if axes[0][0].get_yscale() == "log":
        marks = (("_", "p50"), ("d", "mean"), ("o", "p99"))
        handles += [
            Line2D([], [], color="0.3", marker=marker, linestyle="", label=label, markeredgewidth=1.5)
            for marker, label in marks
        ]
    else:
        handles.append(Line2D([], [], color="0.3", marker="o", linestyle="", label="nothing lost", markersize=4))
    figure.suptitle(f"{title}: {rounds(document)}", fontsize=12)
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False)
