"""Table, picture and document of the real link beside the virtual one."""

from __future__ import annotations

import json
from dataclasses import asdict
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.link_course import MBIT
from scripts.bench.link_figures import FIGURES, gather
from scripts.bench.picture import picture

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from arpd.adapters.sim.result import TopicResult
    from scripts.bench.link_course import Belief, Run, Scenario

COMMAND_TOPIC = "/cmd_vel"
CAMERA_TOPIC = "/camera/image/compressed"
_LABEL = 38
_CELL = 26


def table(scenarios: Sequence[Scenario], runs: Sequence[Run]) -> str:
    """Return all figures of every scenario, and what the readers received without arpd and with it."""
    shown = [scenario for scenario in scenarios if any(run.scenario == scenario.name for run in runs)]
    head = f"{'':<{_LABEL}}" + "".join(f"{scenario.name:>{_CELL}}" for scenario in shown)
    lines = ["with arpd: median (worst) on the real link | median in virtual time", "", head]
    for name, (what, unit, factor) in FIGURES.items():
        cells = [_figure_cell(_of(runs, scenario, is_managed=True), name, factor) for scenario in shown]
        if any(cells):
            lines.append(f"{f'{what} ({unit})':<{_LABEL}}" + "".join(f"{cell:>{_CELL}}" for cell in cells))
    for side, where in (("real", "on the real link"), ("virtual", "in virtual time")):
        lines += ["", f"without arpd → with arpd, medians {where}", "", head]
        for what, value in _ROWS:
            cells = [
                " → ".join(
                    _median([value(run) for run in _of(runs, scenario, is_managed=managed) if run.side == side])
                    for managed in (False, True)
                )
                for scenario in shown
            ]
            lines.append(f"{what:<{_LABEL}}" + "".join(f"{cell:>{_CELL}}" for cell in cells))
    loads = [run.load for run in runs if run.side == "real"]
    return "\n".join([*lines, "", f"load average {min(loads):.1f} to {max(loads):.1f}"])


def draw(scenarios: Sequence[Scenario], runs: Sequence[Run], path: Path) -> None:
    """Draw estimate, queue and budget of every run over time."""
    size = (1 + 4.2 * len(scenarios), 8)
    legend = "black: the link   blue: with arpd, real   orange: with arpd, virtual\ngrey: without arpd (light: virtual)"
    with picture(path, 3, len(scenarios), dpi=100, figsize=size, sharex="col", squeeze=False) as (figure, rows):
        for column, scenario in enumerate(scenarios):
            _draw_scenario(scenario, runs, *(row[column] for row in rows))
        for row, label in zip(rows, ("estimate (Mbit/s)", "queue at the robot (ms)", "budget (Mbit/s)"), strict=True):
            row[0].set_ylabel(label)
        figure.suptitle(legend, fontsize=10)


def _draw_scenario(scenario: Scenario, runs: Sequence[Run], rate: Any, queue: Any, budget: Any) -> None:
    rate.set_title(scenario.name)
    for run in _of(runs, scenario, is_managed=False):
        queue.plot(*_queue_of(run), color="0.6" if run.side == "real" else "0.8", linewidth=0.8)
    managed = _of(runs, scenario, is_managed=True)
    for run in managed:
        style = {"color": "tab:blue" if run.side == "real" else "tab:orange", "linewidth": 0.9, "alpha": 0.8}
        believing = _believing(run)
        times = [t_s for t_s, _ in believing]
        rate.plot(times, [belief.estimate_bytes_per_second / MBIT for _, belief in believing], **style)
        budget.plot(times, [belief.budget_bytes_per_second / MBIT for _, belief in believing], **style)
        queue.plot(*_queue_of(run), **style)
    if managed:
        times = [instant.t_s for instant in managed[0].course]
        truth = [instant.truth_bytes_per_second / MBIT for instant in managed[0].course]
        for axes in (rate, budget):
            axes.step(times, truth, color="black", linewidth=1.2)
    rate.set_ylim(0, 32)
    budget.set_ylim(0, 32)
    queue.set_yscale("log")
    queue.set_ylim(1, 2000)
    budget.set_xlabel("s")


def _queue_of(run: Run) -> tuple[list[float], list[float]]:
    return [i.t_s for i in run.course], [max(1.0, i.queue_delay_s * 1e3) for i in run.course]


def _believing(run: Run) -> list[tuple[float, Belief]]:
    return [(instant.t_s, instant.belief) for instant in run.course if instant.belief is not None]


def save(about: dict[str, Any], runs: Sequence[Run], path: Path) -> None:
    """Write one line per run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps(as_document(done)) for done in runs]
    path.write_text(json.dumps(about)[:-1] + ', "runs": [\n' + ",\n".join(lines) + "\n]}\n")


def as_document(done: Run) -> dict[str, Any]:
    """Return a run for JSON: all queues, and ``[when, what]`` at each change of what rarely changes."""
    course, believing = done.course, _believing(done)
    return {
        "scenario": done.scenario,
        "side": done.side,
        "with_arpd": done.is_managed,
        "round": done.round,
        "load": done.load,
        "figures": done.figures,
        "topics": [{**asdict(topic), "loss_ratio": topic.loss_ratio} for topic in done.topics],
        "queue_delay_s": [round(instant.queue_delay_s, 4) for instant in course],
        "believed_queue_delay_s": [i.belief and _rounded(i.belief.queue_delay_s) for i in course],
        "truth_bytes_per_second": _changes([(instant.t_s, instant.truth_bytes_per_second) for instant in course]),
        **{
            name: _changes([(t_s, getattr(belief, name)) for t_s, belief in believing])
            for name in (
                *("estimate_bytes_per_second", "foreign_bytes_per_second", "budget_bytes_per_second"),
                *("level_bytes_per_second", "kind", "state", "generation", "levels_by_cause", "swaps"),
            )
        },
    }


def _changes(values: Sequence[tuple[float, Any]]) -> list[tuple[float, Any]]:
    kept: list[tuple[float, Any]] = []
    for t_s, value in values:
        if not kept or kept[-1][1] != _rounded(value):
            kept.append((round(t_s, 1), _rounded(value)))
    return kept


def _rounded(value: Any) -> Any:
    return round(value, 0 if value > 1e3 else 3) if isinstance(value, float) else value


def _of(runs: Sequence[Run], scenario: Scenario, *, is_managed: bool) -> list[Run]:
    return [run for run in runs if run.scenario == scenario.name and run.is_managed == is_managed]


def _figure_cell(runs: Sequence[Run], name: str, factor: float) -> str:
    real = gather([run.figures for run in runs if run.side == "real"], name)
    virtual = gather([run.figures for run in runs if run.side == "virtual"], name)
    if real is None:
        return ""
    text = f"{_number(real[0], factor)} ({_number(real[1], factor)})"
    return text if virtual is None else f"{text} | {_number(virtual[0], factor)}"


def _number(value: float | None, factor: float) -> str:
    if value is None:
        return "never"
    shown = value * factor
    return f"{shown:.2f}" if abs(shown) < 10.0 else f"{shown:.0f}"


def _topic(run: Run, name: str) -> TopicResult:
    return next(topic for topic in run.topics if topic.topic == name)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _worst_age_s(run: Run) -> float | None:
    """Return the worst p99 age of topics of at least 20 Hz; slower topics are always old (s)."""
    ages = [topic.age_p99_s for topic in run.topics if topic.source_rate_hz >= 20.0]
    known = [age for age in ages if age is not None]
    return max(known) if len(known) == len(ages) else None


def _share(run: Run, part: Callable[[TopicResult], int], whole: Callable[[TopicResult], int]) -> float:
    return sum(map(part, run.topics)) / max(1, sum(map(whole, run.topics)))


_ROWS: tuple[tuple[str, Callable[[Run], float | None]], ...] = (
    ("peak queue delay (ms)", lambda run: _scaled(run.figures["peak_queue_s"], 1e3)),
    ("commands, latency p99 (ms)", lambda run: _scaled(_topic(run, COMMAND_TOPIC).latency_p99_s, 1e3)),
    ("camera, latency p50 (ms)", lambda run: _scaled(_topic(run, CAMERA_TOPIC).latency_p50_s, 1e3)),
    ("camera, latency p99 (ms)", lambda run: _scaled(_topic(run, CAMERA_TOPIC).latency_p99_s, 1e3)),
    ("oldest topic, age p99 (ms)", lambda run: _scaled(_worst_age_s(run), 1e3)),
    ("lost of sent (%)", lambda run: 100.0 * _share(run, lambda t: t.lost, lambda t: t.sent)),
    ("delivered (MB)", lambda run: sum(topic.delivered_bytes for topic in run.topics) / 1e6),
)


def _median(values: Sequence[float | None]) -> str:
    """Return the median for a table; a missing value is the worst."""
    if not values:
        return "-"
    known = sorted(value for value in values if value is not None)
    middle = (len(values) - 1) // 2
    if len(known) < len(values) and middle >= len(known):
        return "never"
    value = median(known) if len(known) == len(values) else known[middle]
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"
