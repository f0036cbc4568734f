"""The targets of arpd on every link, judged from the figures, and which of them any side could meet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from arpd.adapters.sim.demo import COMMAND_TOPIC
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
    "goodput/bound": "goodput at least 92 % of the bound's",
    "latency/bound": "p99 latency at most 1.5 times the bound's",
    "age/bound": "p99 age at most twice the bound's",
    "samples": "every sample of /imu and /cmd_vel arrives, in every round",
    "swaps": "at most half as many QoS swaps per minute after the first plan as before issue 17",
}
SUFFICES = (
    "The paper's optimum suffices where its p99 is at most twice the bound's: there, full knowledge of the link gains "
    "little over it. No worse means at most 10 % more."
)
FIRST_SWAPS = 12  # the first plan swaps every topic's publisher
_WORST_LATE, _LEAST_GOODPUT, _NO_WORSE = 0.01, 0.92, 1.1
_SUFFICES, _MOST_AGE, _MOST_LATENCY = 2.0, 2.0, 1.5
_NAMES = {"latency": "latency_p99_s", "age": "age_p99_s"}
#: Links on which every sample of ALWAYS has to arrive.
_LOSSLESS = ("wifi-walk",)
ALWAYS = ("/imu", COMMAND_TOPIC)
# Swaps of arpd's one run of 28 s, with the first plan's, in results/adapt.json of commit 28a5a87.
_SWAPS_BEFORE, _BEFORE_S = {"oscillation": 20, "wifi-walk": 26}, 28.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """One target on one link.

    Parameters
    ----------
    is_met : whether arpd meets it
    is_possible : whether any measured side meets it; no side knows more of the link than the bound
    why : the numbers in words
    """

    link: str
    target: str
    is_met: bool
    is_possible: bool
    why: str


def figures_of(document: Mapping[str, Any]) -> dict[tuple[str, str], dict[str, float]]:
    """Return the medians over the rounds, by link and side; never is infinite."""
    durations_s = {link["name"]: link["duration_s"] for link in document["links"]}
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in document["runs"]:
        found.setdefault((run["link"], run["side"]), []).append(_flat(run, durations_s[run["link"]]))
    return {key: _medians(runs) for key, runs in found.items()}


def ranges_of(document: Mapping[str, Any], figure: str) -> dict[tuple[str, str], tuple[float, float]]:
    """Return the least and the largest value of a figure over the rounds, by link and side; never is infinite."""
    found: dict[tuple[str, str], list[float]] = {}
    for run in document["runs"]:
        value = run["all"][figure]
        found.setdefault((run["link"], run["side"]), []).append(math.inf if value is None else float(value))
    return {key: (min(values), max(values)) for key, values in found.items()}


def _flat(run: Mapping[str, Any], duration_s: float) -> dict[str, Any]:
    return {
        **run["all"],
        **{f"cpu_{name}": share for name, share in run["cpu"].items()},
        **{f"{name}/{figure}": value for name, of in run.get("classes", {}).items() for figure, value in of.items()},
        "swaps": run["swaps"],
        "swaps_per_minute": max(0, run["swaps"] - FIRST_SWAPS) * 60.0 / duration_s,
        "unassembled": run["reassembly"]["failed"],
    }


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
    """Judge every link over which arpd and the bound were measured, beside the other sides that were."""
    figures = figures_of(document)
    verdicts: list[Verdict] = []
    for link in document["links"]:
        name = link["name"]
        if (name, ARPD) in figures and (name, ORACLE) in figures:
            found = [*_of_link(name, figures), *_of_samples(document, name), *_of_swaps(name, figures)]
            verdicts += sorted(found, key=lambda verdict: list(TARGETS).index(verdict.target))
    return verdicts


def _of_link(link: str, figures: Figures) -> list[Verdict]:
    ours, bound = figures[link, ARPD], figures[link, ORACLE]
    defaults, paper = figures.get((link, DEFAULTS)), figures.get((link, PAPER))
    verdicts = []
    for what, name in _NAMES.items():
        ratio = _MOST_LATENCY if what == "latency" else _MOST_AGE
        allowed = {"bound": (name, ratio * bound[name])}
        if math.isinf(ours[name]) and math.isinf(bound[name]):  # both lose too much: compare what arrived
            allowed["bound"] = ("survivors_p99_s", ratio * bound["survivors_p99_s"])
        if defaults:
            allowed["defaults"] = (name, defaults[name] / 5)
        if paper:
            suffices = paper[name] <= _SUFFICES * bound[name]
            allowed["paper"] = (name, paper[name] * _NO_WORSE if suffices else paper[name] / 3)
        for whose, (figure, most_s) in allowed.items():
            verdicts.append(_at_most(f"{what}/{whose}", link, figures, figure=figure, most=most_s, show=seconds))
    late = "command_late_share"
    verdicts.append(_at_most("commands", link, figures, figure=late, most=_WORST_LATE, show=_percent))
    goodput, most = (side["goodput_bytes_per_second"] for side in (ours, bound))
    is_met, why = goodput >= _LEAST_GOODPUT * most, f"{_percent(goodput / most if most else 0.0)} of the bound's"
    return [*verdicts, Verdict(link=link, target="goodput/bound", is_met=is_met, is_possible=True, why=why)]


def _of_samples(document: Mapping[str, Any], link: str) -> list[Verdict]:
    if link not in _LOSSLESS:
        return []
    sides = {run["side"] for run in document["runs"] if run["link"] == link}
    missing = {side: sum(map(sum, missing_of(document, link, side).values())) for side in sides}
    ours, bound = (
        ", ".join(
            f"{topic} {lost} lost and {withheld} withheld"
            for topic, (lost, withheld) in missing_of(document, link, side).items()
        )
        for side in (ARPD, ORACLE)
    )
    is_possible = any(not count for count in missing.values())
    why = f"{ours}; the bound {bound}"
    return [Verdict(link=link, target="samples", is_met=not missing[ARPD], is_possible=is_possible, why=why)]


def missing_of(document: Mapping[str, Any], link: str, side: str) -> dict[str, tuple[int, int]]:
    """Return how many samples of each topic of ALWAYS were lost and withheld, in the worst round of each."""
    topics = [run["topics"] for run in document["runs"] if (run["link"], run["side"]) == (link, side)]
    return {name: (max(lost(of[name]) for of in topics), max(of[name]["withheld"] for of in topics)) for name in ALWAYS}


def lost(topic: Mapping[str, Any]) -> int:
    """Return the number of samples that were neither withheld nor received."""
    return max(0, int(topic["offered"] - topic["withheld"] - topic["received"]))


def _of_swaps(link: str, figures: Figures) -> list[Verdict]:
    if link not in _SWAPS_BEFORE:
        return []
    most = (_SWAPS_BEFORE[link] - FIRST_SWAPS) / 2 * 60.0 / _BEFORE_S
    return [_at_most("swaps", link, figures, figure="swaps_per_minute", most=most, show=lambda rate: f"{rate:.1f}")]


def _at_most(
    target: str, link: str, figures: Figures, *, figure: str, most: float, show: Callable[[float], str]
) -> Verdict:
    # An infinite bound is met by any finite value, not by never.
    values = {side: found[figure] for (where, side), found in figures.items() if where == link}
    meeting = [side for side, value in values.items() if math.isfinite(value) and value <= most]
    allowed = show(most) if math.isfinite(most) else "any arrival"
    why = f"{show(values[ARPD])}, allowed {allowed}, the bound {show(values[ORACLE])}"
    return Verdict(link=link, target=target, is_met=ARPD in meeting, is_possible=bool(meeting), why=why)


def seconds(value: float) -> str:
    """Return a time for a table."""
    if not math.isfinite(value):
        return "never"
    return f"{value * 1e3:.0f} ms" if value < 1.0 else f"{value:.1f} s"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
