"""The quality of the capacity estimate for docs/results.md, from the results of `estimate.py` and `link.py`."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.estimate_grid import SHOWN
from scripts.bench.estimate_report import TARGETS, Target
from scripts.bench.record import described
from scripts.bench.report import markdown_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: Figure of a target on the real link: scenarios of `link.py` (none = all), and the figure's name there.
_REAL = {
    "reaction of the estimate to 20→5": (("20→5",), "reaction_s"),
    "reaction of the budget to 20→5": (("20→5",), "budget_s"),
    "queue peak, 20→5": (("20→5",), "peak_queue_s"),
    "rise 5→20 to 80 %, estimate": (("5→20",), "rise_s"),
    "steady error, p90": (("steady 20", "steady 5"), "error_p90"),
    "levels per minute, steady": (("steady 20", "steady 5"), "levels_per_minute"),
    "probes and reports, any scenario": ((), "measuring"),
    "outage, budget closed within": (("outage",), "closed_s"),
    "outage, recovery to 80 %": (("outage",), "recovery_s"),
}
_WAYS = {"arpd": "arpd", "average": "the average of the throughput", "maximum": "its maximum over 8 s"}


def markdown(estimate: dict[str, Any], link: dict[str, Any]) -> str:
    """Return a row per target, the missed targets, the estimates from throughput alone, and the grid's worst cells."""
    measured = {entry["target"]: entry for entry in estimate["targets"]}
    targets = [target for target in TARGETS if target.title in measured]
    rounds = max((run["round"] for run in link["runs"]), default=0)
    rows = []
    for target in targets:
        what, limit = _parts(target)
        simulated = _middle_and_worst(target, measured[target.title]["median"], measured[target.title]["worst"])
        rows.append([what, limit, simulated, _real(target, what, link["runs"])])
    missed = [target for target in targets if not measured[target.title]["met"]]
    head = (
        f"`scripts/bench/estimate.py` in virtual time, {estimate['seeds']} seeds, a robot that wants more than the "
        f"link carries ({described(estimate)}); `scripts/bench/link.py` with real rclpy over namespaces and a token "
        f"bucket, the demo robot, {'one run' if rounds == 1 else f'{rounds} runs'} each ({described(link)}): "
        "median (worst)."
    )
    lines = [head, "", *markdown_table("llr", ["", "target", "simulated", "real link"], rows), ""]
    lines += [_on_targets(missed, len(targets), measured), _on_throughput(estimate["scenarios"])]
    return "\n".join([*lines, *_on_grid(estimate.get("grid", []))])


def _parts(target: Target) -> tuple[str, str]:
    what, _, limit = target.title.rpartition(": ")
    return what, limit.replace("<=", "≤").replace(">=", "≥")


def _middle_and_worst(target: Target, middle: float | None, worst: float | None) -> str:
    first, second = (target.shown(math.inf if value is None else value) for value in (middle, worst))
    text = first if middle is None else f"{first} {target.unit}".rstrip()
    return text if first == second else f"{text} ({second})"


def _real(target: Target, what: str, runs: Sequence[dict[str, Any]]) -> str:
    if what not in _REAL:
        return "–"
    scenarios, figure = _REAL[what]
    values = [
        value
        for run in runs
        if run["side"] == "real" and run["with_arpd"] and (not scenarios or run["scenario"] in scenarios)
        if figure in run["figures"] or figure == "measuring"  # an earlier version may not have looked at it
        for value in [_figure(run["figures"], figure)]
    ]
    if not values:
        return "–"
    known = sorted(math.inf if value is None else value for value in values)
    middle, worst = (value if math.isfinite(value) else None for value in (median(known), known[-1]))
    return _middle_and_worst(target, middle, worst)


def _figure(figures: dict[str, Any], name: str) -> float | None:
    if name == "measuring":
        return float(figures["probe_share"] + figures["report_share"])
    value = figures.get(name)
    return None if value is None else float(value)


def _on_targets(missed: Sequence[Target], count: int, measured: dict[str, dict[str, Any]]) -> str:
    by_median = [t for t in missed if not t.keeps(measured[t.title]["median"])]
    by_worst = [t for t in missed if t not in by_median]
    met = f"{count - len(missed)} of {count}" if missed else f"all {count}"
    text = f"Simulated, the median and the worst seed meet {met} targets."
    for who, those in (("The worst seed", by_worst), ("The median, too,", by_median)):
        if those:
            text += f" {who} misses: {'; '.join(_parts(target)[0] for target in those)}."
    return text


def _on_throughput(scenarios: dict[str, dict[str, list[dict[str, float | None]]]]) -> str:
    """Compare with estimates from throughput alone, over the scenarios that they play."""
    compared = []
    common = {name: ways for name, ways in scenarios.items() if _WAYS.keys() <= ways.keys()}
    if not common:
        return ""
    for way, words in _WAYS.items():
        played = [ways[way] for ways in common.values()]
        goodput = f"{100 * _over(played, 'utilisation', median):.0f} % of the bound's goodput"
        queue_s = _over(played, "queue peak", max)
        queues = f"queues of up to {queue_s:.1f} s" if math.isfinite(queue_s) else "endless queues"
        compared.append(f"{words} {goodput} with {queues}")
    return (
        f"Medians of the seeds over {len(common)} scenarios ({', '.join(common)}): {'; '.join(compared)} "
        "(scripts/bench/results/estimate.png)."
    )


def _on_grid(judged: Sequence[dict[str, Any]]) -> list[str]:
    """Return the worst cells of the grid, which are the first."""
    if not judged:
        return []
    ratios = [each["ratio"] for each in judged]
    rows = [
        [
            each["cell"],
            f"{each['ratio']:.1f}",
            *(f"{1e3 * each[f'arpd_{name}']:.0f} / {1e3 * each[f'bound_{name}']:.0f} ms" for name in ("p50", "p99")),
            " / ".join(f"{each[f'{side}_goodput'] * 8e-6:.1f}" for side in ("arpd", "bound")) + " Mbit/s",
        ]
        for each in judged[:SHOWN]
    ]
    head = (
        f"A grid of links and disturbances, {len(judged)} cells at random: queue or goodput is {median(ratios):.2f} "
        "times as bad as the bound's in the median (`scripts/bench/estimate_grid.py`). The worst cells, arpd / bound:"
    )
    return ["", head, "", *markdown_table("lrrrr", ["", "ratio", "queue p50", "queue p99", "goodput"], rows)]


def _over(
    played: Sequence[list[dict[str, float | None]]], figure: str, of_all: Callable[[Sequence[float]], float]
) -> float:
    """Return ``of_all`` over the scenarios' medians of a figure; never is infinite."""
    medians = [
        median([math.inf if value is None else value for value in values])
        for every in played
        if (values := [metrics[figure] for metrics in every if figure in metrics])
    ]
    return of_all(medians)
