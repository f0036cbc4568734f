"""The picture of `adapt.py`: each link with arpd's estimate, the age of the newest sample, and every side's p99."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scripts.bench.adapt_figures import TIMELINE_S, figures_of
from scripts.bench.adapt_sides import ARPD, label
from scripts.bench.picture import picture

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_STYLES: dict[str, dict[str, Any]] = {
    "defaults": {"color": "tab:red", "linewidth": 1.2},
    "keep-last-1": {"color": "tab:pink", "linewidth": 0.9},
    "keep-last-5000": {"color": "tab:brown", "linewidth": 0.9},
    "paper": {"color": "tab:orange", "linewidth": 1.2},
    "throttle": {"color": "tab:green", "linewidth": 0.9},
    "arpd": {"color": "tab:blue", "linewidth": 2.2, "zorder": 4},
    "oracle": {"color": "black", "linewidth": 1.2, "linestyle": "--", "zorder": 5},
}
_LEAST_S, _NEVER_S = 0.01, 60.0


def draw(document: Mapping[str, Any], path: Path) -> None:
    """Draw one row per link: over time the first round, as p99 the medians of all rounds."""
    from matplotlib.lines import Line2D

    links, sides = document["links"], list(document["sides"])
    figures = figures_of(document)
    size, ratios = (13, 0.9 + 1.9 * len(links)), {"width_ratios": (3, 4, 4)}
    with picture(path, len(links), 3, figsize=size, squeeze=False, gridspec_kw=ratios) as (figure, rows):
        for link, (rate, age, p99) in zip(links, rows, strict=True):
            _draw_link(link, rate)
            _draw_estimate(document, link["name"], rate)
            _draw_ages(document, link["name"], age)
            _draw_p99({side: figures[link["name"], side] for side in sides if (link["name"], side) in figures}, p99)
            for axes in (rate, age):
                axes.set_xlim(0, link["duration_s"])
        rows[0][0].set_title("link and arpd's estimate (Mbit/s); red: loss")
        rows[0][1].set_title("age of the newest sample, mean of 12 topics (s)")
        rows[0][2].set_title("p99 (s)   ● latency   ◇ age")
        for axes in rows[-1][:2]:
            axes.set_xlabel("s")
        handles = [Line2D([], [], label=label(side), **_STYLES[side]) for side in sides]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(sides), frameon=False)


def _draw_link(link: Mapping[str, Any], axes: Any) -> None:
    times = [start_s for start_s, _ in link["rates"]] + [link["duration_s"]]
    rates = [rate * 8e-6 for _, rate in link["rates"]]
    axes.stairs(rates, times, color="0.25", fill=True, alpha=0.25)
    axes.stairs(rates, times, color="0.25", linewidth=1.2)
    ends_s = [*(start_s for start_s, _ in link["losses"][1:]), link["duration_s"]]
    for (start_s, loss), end_s in zip(link["losses"], ends_s, strict=False):
        if loss:
            axes.axvspan(start_s, end_s, color="tab:red", alpha=min(1.0, 0.15 + 0.5 * loss), linewidth=0)
    axes.set_ylim(0, 22)
    axes.set_ylabel(link["name"], fontweight="bold")


def _draw_estimate(document: Mapping[str, Any], link: str, axes: Any) -> None:
    for run in document["runs"]:
        if (run["link"], run["side"], run["round"]) == (link, ARPD, 1):
            known = [(TIMELINE_S * k, rate * 8e-6) for k, rate in enumerate(run.get("estimates_over_time", [])) if rate]
            axes.plot([at_s for at_s, _ in known], [rate for _, rate in known], **_STYLES[ARPD])


def _draw_ages(document: Mapping[str, Any], link: str, axes: Any) -> None:
    for run in document["runs"]:
        if run["link"] == link and run["round"] == 1:
            ages = run["ages_over_time_s"]
            axes.plot([TIMELINE_S * (k + 0.5) for k in range(len(ages))], ages, **_STYLES[run["side"]])
    axes.set_yscale("log")
    axes.set_ylim(0.04, 20)
    axes.grid(visible=True, color="0.9")


def _draw_p99(figures: Mapping[str, Mapping[str, float]], axes: Any) -> None:
    for row, (side, found) in enumerate(figures.items()):
        color = _STYLES[side]["color"]
        latency_s, age_s = (min(_NEVER_S, found[name]) for name in ("latency_p99_s", "age_p99_s"))
        axes.plot([latency_s, age_s], [row, row], color=color, linewidth=1, alpha=0.5)
        axes.plot(latency_s, row, marker="o", color=color, clip_on=False)
        axes.plot(age_s, row, marker="D", color=color, markerfacecolor="white", clip_on=False)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST_S, _NEVER_S)
    axes.set_xticks([0.01, 0.1, 1, 10, _NEVER_S], ["0.01", "0.1", "1", "10", "never"])
    axes.set_yticks(range(len(figures)), list(map(label, figures)))
    axes.invert_yaxis()
    axes.grid(visible=True, axis="x", color="0.9")
