"""The report of `adapt.py`: every side on every link, and the targets, which of them arpd meets and any side could."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from arpd.adapters.sim.demo import COMMAND_TOPIC
from scripts.bench.adapt_figures import CLASSES, FIRST_SWAPS, figures_of, ranges_of, topics_of
from scripts.bench.adapt_sides import ARPD, DEFAULTS, ORACLE, PAPER, label
from scripts.bench.record import described
from scripts.bench.report import Column, Form, details, milli, paragraphs, percent, spread, table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Figures = Mapping[tuple[str, str], Mapping[str, float]]  # by link and side

#: Short names of the targets, in the order of the report.
TARGETS = {
    "latency/defaults": "p99 latency at most 1/5 of rclpy's defaults'",
    "age/defaults": "p99 age at most 1/5 of rclpy's defaults'",
    "latency/paper": "p99 latency at most 1/3 of the paper's optimum's; 1.1 where that is at most twice the bound's",
    "age/paper": "p99 age at most 1/3 of the paper's optimum's; 1.1 where that is at most twice the bound's",
    "commands": "at most 1 % of the commands later than 100 ms",
    "goodput/bound": "goodput at least 92 % of the bound's",
    "latency/bound": "p99 latency at most 1.5 times the bound's",
    "age/bound": "p99 age at most twice the bound's",
    "samples": "every sample of /imu and /cmd_vel arrives, in every round",
    "swaps": "at most half as many QoS swaps per minute after the first plan as before issue 17",
}
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
    found, allowed, bound : arpd's figure, the most or least that it may be, and the bound's figure
    """

    link: str
    target: str
    is_met: bool
    is_possible: bool
    found: str
    allowed: str
    bound: str


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
    share = goodput / most if most else 0.0
    verdicts.append(
        Verdict(
            link=link,
            target="goodput/bound",
            is_met=share >= _LEAST_GOODPUT,
            is_possible=True,
            found=_percent(share),
            allowed=_percent(_LEAST_GOODPUT),
            bound=_percent(1.0),
        )
    )
    return verdicts


def _of_samples(document: Mapping[str, Any], link: str) -> list[Verdict]:
    if link not in _LOSSLESS:
        return []
    sides = {run["side"] for run in document["runs"] if run["link"] == link}
    missing = {side: sum(map(sum, missing_of(document, link, side).values())) for side in sides}
    return [
        Verdict(
            link=link,
            target="samples",
            is_met=not missing[ARPD],
            is_possible=any(not count for count in missing.values()),
            found=_missing(document, link, ARPD),
            allowed="none",
            bound=_missing(document, link, ORACLE),
        )
    ]


def _missing(document: Mapping[str, Any], link: str, side: str) -> str:
    return ", ".join(f"{lost} + {withheld}" for lost, withheld in missing_of(document, link, side).values())


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
    # An infinite limit is met by any finite value, not by never.
    values = {side: found[figure] for (where, side), found in figures.items() if where == link}
    meeting = [side for side, value in values.items() if math.isfinite(value) and value <= most]
    return Verdict(
        link=link,
        target=target,
        is_met=ARPD in meeting,
        is_possible=bool(meeting),
        found=show(values[ARPD]),
        allowed=show(most) if math.isfinite(most) else "any arrival",
        bound=show(values[ORACLE]),
    )


def seconds(value: float) -> str:
    """Return a time for a table."""
    if not math.isfinite(value):
        return "never"
    return f"{value * 1e3:.0f} ms" if value < 1.0 else f"{value:.1f} s"


def _percent(share: float) -> str:
    return f"{percent(share)} %"


def _mbit(bytes_per_second: float) -> str:
    return f"{bytes_per_second * 8e-6:.2f}"


_COLUMNS: tuple[tuple[str, str, Form], ...] = (
    ("latency p50", "latency_p50_s", seconds),
    ("latency p99", "latency_p99_s", seconds),
    ("of those that came", "survivors_p99_s", seconds),
    ("max", "latency_max_s", seconds),
    ("age p50", "age_p50_s", seconds),
    ("age p99", "age_p99_s", seconds),
    ("beyond period", "beyond_p99_s", seconds),
    ("Mbit/s", "goodput_bytes_per_second", _mbit),
    ("lost %", "loss_ratio", percent),
    ("withheld %", "withheld_ratio", percent),
    ("stalled %", "stalled_ratio", percent),
    ("late cmd %", "command_late_share", percent),
    ("unassembled", "unassembled", "{:.0f}"),
    ("swaps", "swaps", "{:.0f}"),
    *((f"{name} %", f"cpu_{name}", percent) for name in ("run", "relay", "peer", "sources", "machine")),
)
_LEGEND = (
    "A sample counts as lost if it has not arrived four seconds after the end, and a lost sample never arrives: with "
    "more than 1 % lost, the p99 is never. Beside it is the p99 of the samples that came. Age: of the newest sample at "
    "the reader. Beyond period: the p99 of the age above a period of the source. Withheld: pacing chose a fresher "
    "sample. Stalled: not published because publish() blocked or the processor was busy. Late commands took over "
    "100 ms or were lost. Unassembled: datagrams with fragments that the receiving kernel missed. CPU in per cent of a "
    "core; machine: of all its cores."
)
_BOUND_LEGEND = (
    "arpd beside the bound, with the range over the rounds. Times: of the p99 latency, for all topics and for each "
    "class; large: samples of several packets; where either side loses more than 1 %, of what came. Swaps: after the "
    f"first plan. Never came: samples of {' and of '.join(ALWAYS)} that were lost + withheld, in the worst round."
)
#: Figures of `adapt_estimate.py`, with their heads and forms.
_ESTIMATES: tuple[tuple[str, str, Form], ...] = (
    ("error p90 %", "error_p90", percent),
    ("bias %", "bias", percent),
    ("within 15 % s", "reaction_s", "{:.1f}"),
    ("budget fits s", "budget_s", "{:.1f}"),
    ("rise to 80 % s", "rise_s", "{:.1f}"),
    ("budget closed s", "closed_s", "{:.1f}"),
    ("back to 80 % s", "recovery_s", "{:.1f}"),
    ("traffic back s", "traffic_back_s", "{:.1f}"),
    ("queue before ms", "start_queue_s", milli),
    ("queue peak ms", "peak_queue_s", milli),
    ("carried %", "utilisation", percent),
    ("probes %", "probe_share", percent),
    ("reports %", "report_share", percent),
    ("plans/min", "plans_per_minute", "{:.1f}"),
    ("swaps/min", "swaps_per_minute", "{:.1f}"),
)


def report(document: Mapping[str, Any]) -> str:
    """Return every side on every link, arpd beside the bound, the targets, and all figures."""
    figures, verdicts = figures_of(document), judge(document)
    rows = [(link["name"], side) for link in document["links"] for side in document["sides"]]
    return paragraphs(
        "Latency and age over all twelve topics, each with the same weight; a lost sample never arrives:",
        _crossed(document, list(document["sides"])),
        "\n".join(
            [
                *(f"- **{label(side)}**: {what}" for side, what in document["sides"].items()),
                *(f"- `{link['name']}`: {link['what']}" for link in document["links"]),
            ]
        ),
        _measured(document),
        _beside_bound(document),
        _targets(verdicts) if verdicts else "",
        details(
            "All figures",
            _LEGEND,
            table(
                [row for row in rows if row in figures],
                ("link", 0),
                ("side", lambda row: label(row[1])),
                *((head, partial(_figure, figures, name), form) for head, name, form in _COLUMNS),
            ),
        ),
    )


def summary(document: Mapping[str, Any]) -> str:
    """Return the small table at the top of README.md."""
    return _crossed(document, [side for side in (DEFAULTS, PAPER, ARPD, ORACLE) if side in document["sides"]])


def more_tables(document: Mapping[str, Any]) -> str:
    """Return p99 latency and age of each topic, and the quality of the estimate, which only a terminal shows."""
    runs = estimates_of(document)["runs"]
    names = list(dict.fromkeys(run["link"] for run in runs))

    def over_rounds(name: str, key: str, form: Form) -> str:
        return spread([run["estimate"][key] for run in runs if run["link"] == name and key in run["estimate"]], form)

    columns: list[Column] = [(head, partial(over_rounds, key=key, form=form)) for head, key, form in _ESTIMATES]
    return paragraphs(
        *(_by_topic(document, link["name"]) for link in document["links"]),
        table(names, ("arpd's estimate, median (largest)", str), *columns) if names else "",
    )


def _by_topic(document: Mapping[str, Any], link: str) -> str:
    topics = topics_of(document, link)
    sides = dict.fromkeys(side for of in topics.values() for side in of)
    columns: list[Column] = [(label(side), lambda name, side=side: _p99s(topics[name][side])) for side in sides]
    return table(topics, (f"{link}: p99 latency / age", str), *columns)


def estimates_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `estimate_figures` of arpd's runs by link, their source and their conditions.

    Until the links have been measured again, they are those of an earlier benchmark, the document's ``estimates``.
    """
    runs = [run for run in document["runs"] if run["side"] == ARPD and "estimate" in run]
    if not runs and "estimates" in document:
        return dict(document["estimates"])
    return {"what": "`scripts/bench/adapt.py`", "conditions": document["conditions"], "runs": runs}


def _figure(figures: Figures, name: str, row: tuple[str, str]) -> float | None:
    return figures[row].get(name)


def _crossed(document: Mapping[str, Any], sides: list[str]) -> str:
    figures = figures_of(document)

    def cell(link: str, side: str) -> str:
        shown = _p99s(figures[link, side]) if (link, side) in figures else ""
        return f"**{shown}**" if side == ARPD and shown else shown

    columns: list[Column] = [(label(side), partial(cell, side=side)) for side in sides]
    return table([link["name"] for link in document["links"]], ("p99 latency / p99 age", str), *columns)


def _p99s(figures: Mapping[str, float]) -> str:
    return f"{seconds(figures['latency_p99_s'])} / {seconds(figures['age_p99_s'])}"


def _measured(document: Mapping[str, Any]) -> str:
    """Return how often, when and on what everything was measured."""
    rounds = max((run["round"] for run in document["runs"]), default=0)
    busy = [run["cpu"]["machine"] for run in document["runs"]] or [0.0]
    text = (
        f"Medians of {rounds} rounds; the machine was {100 * min(busy):.0f} to {100 * max(busy):.0f} % busy "
        f"({described(dict(document))})."
    )
    if apart := document.get("apart"):
        text += f" Measured again after the others: {', '.join(map(label, apart['sides']))} ({described(apart)})."
    return text


def _beside_bound(document: Mapping[str, Any]) -> str:
    """Return arpd beside the bound on every link, with the range over the rounds."""
    figures = figures_of(document)
    names = [link["name"] for link in document["links"]]
    names = [name for name in names if (name, ARPD) in figures and (name, ORACLE) in figures]
    goodput = "goodput_bytes_per_second"

    def both(what: str, value: Callable[[str, str], str]) -> list[Column]:
        return [(what, lambda link: value(link, ARPD)), ("bound's", lambda link: value(link, ORACLE))]

    def ranged(figure: str, show: Callable[[float], str]) -> Callable[[str, str], str]:
        ranges = ranges_of(document, figure)
        return lambda link, side: _ranged(figures[link, side][figure], ranges[link, side], show)

    def times(whose: str) -> Column:
        return (f"{whose}, times" if whose else "times", lambda link: times_of(whose, figures, link), "{:.2f}")

    columns = [
        *both("p99 latency", ranged("latency_p99_s", seconds)),
        *map(times, ("", *CLASSES)),
        *both("Mbit/s", ranged(goodput, _mbit)),
        ("%", lambda link: percent(figures[link, ARPD][goodput] / figures[link, ORACLE][goodput])),
        *both("swaps/min", lambda link, side: f"{figures[link, side]['swaps_per_minute']:.1f}"),
        *both("never came", lambda link, side: _missing(document, link, side)),
    ]
    return paragraphs(_BOUND_LEGEND, table(names, ("", str), *columns)) if names else ""


def _ranged(middle: float, span: tuple[float, float], show: Callable[[float], str]) -> str:
    least, most = map(show, span)
    return show(middle) if least == most else f"{show(middle)} ({least}–{most})"


def times_of(whose: str, figures: Figures, link: str) -> float | None:
    """Return arpd's p99 latency over the bound's, of a class or of all topics; of what came where either loses much."""
    prefix = f"{whose}/" if whose else ""
    for name in ("latency_p99_s", "survivors_p99_s"):
        ours, bound = (figures[link, side].get(prefix + name) for side in (ARPD, ORACLE))
        if ours and bound and math.isfinite(ours + bound):
            return ours / bound
    return None


def _targets(verdicts: list[Verdict]) -> str:
    """Return on how many links each target is met, and every miss with its numbers."""
    judged = {name: [one.is_met for one in verdicts if one.target == name] for name in TARGETS}
    return paragraphs(
        f"Targets: {sum(one.is_met for one in verdicts)} of {len(verdicts)} met.",
        table(
            [name for name in TARGETS if judged[name]],
            ("target", lambda name: TARGETS[name]),
            ("links", lambda name: f"{sum(judged[name])} of {len(judged[name])}"),
        ),
        table(
            [one for one in verdicts if not one.is_met],
            ("missed", lambda one: TARGETS[one.target].split("; ")[0]),
            ("link", lambda one: one.link),
            ("arpd", lambda one: one.found),
            ("allowed", lambda one: one.allowed),
            ("bound", lambda one: one.bound),
            ("met by any side", lambda one: "yes" if one.is_possible else "no"),
        ),
    )
