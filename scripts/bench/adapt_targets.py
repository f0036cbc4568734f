"""The targets of arpd on every link, judged from the figures, and which of them any side could meet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.adapt_sides import ARPD, DEFAULTS, ORACLE, PAPER

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Figures = Mapping[tuple[str, str], Mapping[str, float]]  # by link and side

#: Short names of the targets, in the order of the report's columns.
TARGETS = {
    "latency/defaults": "p99 latency at most 1/5 of rclpy's defaults'",
    "age/defaults": "p99 age at most 1/5 of rclpy's defaults'",
    "latency/paper": "p99 latency at most 1/3 of the paper's optimum's, or no worse where that suffices",
    "age/paper": "p99 age at most 1/3 of the paper's optimum's, or no worse where that suffices",
    "commands": "at most 1 % of the commands later than 100 ms",
    "goodput/oracle": "goodput at least 85 % of the oracle's",
    "latency/oracle": "p99 latency at most twice the oracle's",
    "age/oracle": "p99 age at most twice the oracle's",
}
SUFFICES = (
    "The paper's optimum suffices where its p99 is at most twice the oracle's: there, full knowledge of the link gains "
    "little over it. No worse means at most 10 % more."
)
_WORST_LATE, _LEAST_GOODPUT, _NO_WORSE = 0.01, 0.85, 1.1
_NAMES = {"latency": "latency_p99_s", "age": "age_p99_s"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """One target on one link.

    Parameters
    ----------
    is_met : whether arpd meets it
    is_possible : whether any measured side meets it; no side knows more of the link than the oracle
    why : the numbers in words
    """

    link: str
    target: str
    is_met: bool
    is_possible: bool
    why: str


def figures_of(document: Mapping[str, Any]) -> dict[tuple[str, str], dict[str, float]]:
    """Return the medians over the rounds, by link and side; never is infinite."""
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in document["runs"]:
        cpu = {f"cpu_{name}": share for name, share in run["cpu"].items()}
        others = {"swaps": run["swaps"], "unassembled": run["reassembly"]["failed"]}
        found.setdefault((run["link"], run["side"]), []).append({**run["all"], **cpu, **others})
    return {key: _medians(runs) for key, runs in found.items()}


def topics_of(document: Mapping[str, Any], link: str) -> dict[str, dict[str, dict[str, float]]]:
    """Return the medians of every topic on one link, by topic and side."""
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for run in document["runs"]:
        if run["link"] == link:
            for topic, figures in run["topics"].items():
                found.setdefault(topic, {}).setdefault(run["side"], []).append(figures)
    return {topic: {side: _medians(runs) for side, runs in sides.items()} for topic, sides in found.items()}


def _medians(runs: list[dict[str, Any]]) -> dict[str, float]:
    return {name: median([math.inf if one[name] is None else float(one[name]) for one in runs]) for name in runs[0]}


def judge(document: Mapping[str, Any]) -> list[Verdict]:
    """Judge every link whose sides were all measured."""
    figures = figures_of(document)
    verdicts: list[Verdict] = []
    for link in (link["name"] for link in document["links"]):
        if all((link, side) in figures for side in (ARPD, ORACLE, DEFAULTS, PAPER)):
            verdicts += _of_link(link, figures)
    return verdicts


def _of_link(link: str, figures: Figures) -> list[Verdict]:
    ours, oracle, defaults, paper = (figures[link, side] for side in (ARPD, ORACLE, DEFAULTS, PAPER))
    verdicts = []
    for what, name in _NAMES.items():
        suffices = paper[name] <= 2 * oracle[name]
        bounds = {
            "defaults": (name, defaults[name] / 5),
            "paper": (name, paper[name] * _NO_WORSE if suffices else paper[name] / 3),
            "oracle": (name, 2 * oracle[name]),
        }
        if math.isinf(ours[name]) and math.isinf(oracle[name]):  # both lose too much: compare what arrived
            bounds["oracle"] = ("survivors_p99_s", 2 * oracle["survivors_p99_s"])
        for whose, (figure, bound_s) in bounds.items():
            target = f"{what}/{whose}"
            verdicts.append(_at_most(target, link, figures, figure=figure, bound=bound_s, show=seconds))
    late = "command_late_share"
    verdicts.append(_at_most("commands", link, figures, figure=late, bound=_WORST_LATE, show=_percent))
    goodput, most = (side["goodput_bytes_per_second"] for side in (ours, oracle))
    is_met, why = goodput >= _LEAST_GOODPUT * most, f"{_percent(goodput / most if most else 0.0)} of the oracle's"
    verdicts.append(Verdict(link=link, target="goodput/oracle", is_met=is_met, is_possible=True, why=why))
    return sorted(verdicts, key=lambda verdict: list(TARGETS).index(verdict.target))


def _at_most(
    target: str, link: str, figures: Figures, *, figure: str, bound: float, show: Callable[[float], str]
) -> Verdict:
    # An infinite bound is met by any finite value, not by never.
    values = {side: found[figure] for (where, side), found in figures.items() if where == link}
    meeting = [side for side, value in values.items() if math.isfinite(value) and value <= bound]
    allowed = show(bound) if math.isfinite(bound) else "any arrival"
    why = f"{show(values[ARPD])}, allowed {allowed}, the oracle {show(values[ORACLE])}"
    return Verdict(link=link, target=target, is_met=ARPD in meeting, is_possible=bool(meeting), why=why)


def seconds(value: float) -> str:
    """Return a time for a table."""
    if not math.isfinite(value):
        return "never"
    return f"{value * 1e3:.0f} ms" if value < 1.0 else f"{value:.1f} s"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
