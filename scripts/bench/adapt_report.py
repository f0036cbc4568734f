"""The tables of `adapt.py`, from its document alone: as text, for docs/results.md and for README.md."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from scripts.bench.adapt_figures import CLASSES
from scripts.bench.adapt_sides import ARPD, DEFAULTS, ORACLE, PAPER, label
from scripts.bench.adapt_targets import (
    ALWAYS,
    SUFFICES,
    TARGETS,
    figures_of,
    judge,
    missing_of,
    ranges_of,
    seconds,
    topics_of,
)
from scripts.bench.record import described
from scripts.bench.report import markdown_table, percent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from scripts.bench.adapt_targets import Verdict


def _mbit(bytes_per_second: float) -> str:
    return f"{bytes_per_second * 8e-6:.2f}"


def _count(count: float) -> str:
    return f"{count:.0f}"


_COLUMNS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
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
    ("unassembled", "unassembled", _count),
    ("swaps", "swaps", _count),
    ("run %", "cpu_run", percent),
    ("relay %", "cpu_relay", percent),
    ("peer %", "cpu_peer", percent),
    ("sources %", "cpu_sources", percent),
    ("machine %", "cpu_machine", percent),
)
_LETTERS = dict(zip(TARGETS, "ABCDEFGHIJ", strict=True))
_STARVED = 0.9  # of the machine: above this, the planner waits longer than the 50 ms of /imu's history
_LEGEND = (
    "A sample counts as lost if it has not arrived four seconds after the end, and a lost sample never arrives: with "
    "more than 1 % lost, the p99 is never. Beside it is the p99 of the samples that came. Age: of the newest sample at "
    "the reader; on a perfect link it grows up to a period of its source ({slowest}). Beyond period: the p99 of the "
    "age above that. Withheld: pacing chose a fresher sample. Stalled: not published because publish() blocked or the "
    "processor was busy. Late commands took over 100 ms or were lost. Unassembled: datagrams with fragments that the "
    "receiving kernel missed; while they fill its memory for fragments, no large sample arrives. CPU in per cent of a "
    "core; machine: of all its cores."
)
_BOUND_LEGEND = (
    "arpd beside the bound, with the range over the rounds. Times: of the p99 latency, for all topics and for each "
    "class; large: samples of several packets; where either side loses more than 1 %, of what came. Swaps: after the "
    f"first plan. Never came: samples of {' and of '.join(ALWAYS)} that were lost + withheld, in the worst round."
)


def table(document: Mapping[str, Any]) -> str:
    """Return all figures of each link and side, p99 latency and age of each topic, and the targets, as text."""
    figures = figures_of(document)
    heads = [head for head, _, _ in _COLUMNS]
    widths = [max(9, len(head) + 1) for head in heads]
    lines = []
    for link in document["links"]:
        name = link["name"]
        sides = [side for side in document["sides"] if (name, side) in figures]
        lines += [f"{name}: {link['what']}", f"{'':<15}" + "".join(map(str.rjust, heads, widths))]
        lines += [f"{label(side):<15}" + "".join(map(str.rjust, _cells(figures[name, side]), widths)) for side in sides]
        lines += ["", f"{'p99 latency / age':<26}" + "".join(f"{label(side):>20}" for side in sides)]
        for topic, by_side in topics_of(document, name).items():
            lines.append(f"{topic:<26}" + "".join(f"{_p99s(by_side[side]):>20}" for side in sides))
        lines.append("")
    verdicts = judge(document)
    lines += [f"{'met' if one.is_met else _missed(one)}: {one.link}, {one.target}: {one.why}" for one in verdicts]
    return "\n".join([*lines, "", *_beside_bound(document), "", _spread(document)])


def markdown(document: Mapping[str, Any]) -> str:
    """Return the block of docs/results.md."""
    verdicts = judge(document)
    lines = [
        "Latency and age over all twelve topics, each with the same weight; a lost sample never arrives:",
        "",
        *_crossed(document, list(document["sides"])),
        "",
        *(f"- **{label(side)}**: {what}" for side, what in document["sides"].items()),
        *(f"- `{link['name']}`: {link['what']}" for link in document["links"]),
        "",
        _spread(document) + f" ({described(dict(document))}).{_apart(document)}",
        "",
        *_beside_bound(document),
        "",
        f"Targets: {sum(one.is_met for one in verdicts)} of {len(verdicts)} met (–: by no side, not even the bound).",
        "",
        *_target_table(verdicts),
        "",
        *(f"- {_LETTERS[target]}: {what}" for target, what in TARGETS.items()),
        "",
        SUFFICES,
        "",
        *_shortfalls(verdicts),
        "",
        "<details><summary>All figures</summary>",
        "",
        _LEGEND.format(slowest=_slowest(document)),
        "",
        *_details(document),
        "",
        "</details>",
    ]
    return "\n".join(lines)


def summary(document: Mapping[str, Any]) -> str:
    """Return the small table at the top of README.md."""
    sides = [side for side in (DEFAULTS, PAPER, ARPD, ORACLE) if side in document["sides"]]
    return "\n".join(_crossed(document, sides))


def _crossed(document: Mapping[str, Any], sides: list[str]) -> list[str]:
    figures = figures_of(document)

    def cell(link: str, side: str) -> str:
        shown = _p99s(figures[link, side]) if (link, side) in figures else ""
        return f"**{shown}**" if side == ARPD and shown else shown

    rows = [[link["name"], *(cell(link["name"], side) for side in sides)] for link in document["links"]]
    return markdown_table("lr", ["p99 latency / p99 age", *map(label, sides)], rows)


def _beside_bound(document: Mapping[str, Any]) -> list[str]:
    """Return arpd beside the bound on every link, with the range over the rounds."""
    figures = figures_of(document)
    latencies, goodputs = (ranges_of(document, name) for name in ("latency_p99_s", "goodput_bytes_per_second"))
    rows = []
    for link in (link["name"] for link in document["links"]):
        ours, bound = (link, ARPD), (link, ORACLE)
        if ours not in figures or bound not in figures:
            continue
        goodput = "goodput_bytes_per_second"
        rows.append(
            [
                link,
                *(_ranged(figures[side]["latency_p99_s"], latencies[side], seconds) for side in (ours, bound)),
                *(_times(each, figures[ours], figures[bound]) for each in ("", *(f"{each}/" for each in CLASSES))),
                *(_ranged(figures[side][goodput], goodputs[side], _mbit) for side in (ours, bound)),
                percent(figures[ours][goodput] / figures[bound][goodput]),
                *(f"{figures[side]['swaps_per_minute']:.1f}" for side in (ours, bound)),
                *(_missing(document, *side) for side in (ours, bound)),
            ]
        )
    if not rows:
        return []
    head = [
        *("p99 latency", "bound's", "times", *(f"{each}, times" for each in CLASSES)),
        *("Mbit/s", "bound's", "%", "swaps/min", "bound's", "never came", "bound's"),
    ]
    return [_BOUND_LEGEND, "", *markdown_table("lr", ["", *head], rows)]


def _ranged(middle: float, span: tuple[float, float], show: Callable[[float], str]) -> str:
    least, most = map(show, span)
    return show(middle) if least == most else f"{show(middle)} ({least}–{most})"


def _times(whose: str, ours: Mapping[str, float], bound: Mapping[str, float]) -> str:
    """Return arpd's p99 latency over the bound's; of what came, where either loses too much."""
    pairs = [(ours.get(whose + name), bound.get(whose + name)) for name in ("latency_p99_s", "survivors_p99_s")]
    ratios = [mine / least for mine, least in pairs if mine and least and math.isfinite(mine + least)]
    return f"{ratios[0]:.2f}" if ratios else ""


def _missing(document: Mapping[str, Any], link: str, side: str) -> str:
    return ", ".join(f"{lost} + {withheld}" for lost, withheld in missing_of(document, link, side).values())


def _target_table(verdicts: list[Verdict]) -> list[str]:
    marks = {(one.link, one.target): _mark(one) for one in verdicts}
    links = dict.fromkeys(one.link for one in verdicts)
    rows = [[link, *(marks.get((link, target), "") for target in TARGETS)] for link in links]
    return markdown_table("lc", ["", *_LETTERS.values()], rows)


def _shortfalls(verdicts: list[Verdict]) -> list[str]:
    """Name every target that was not met, with its numbers."""
    lines = []
    for title, is_possible in (("Missed", True), ("Met by no side", False)):
        missed = [one for one in verdicts if not one.is_met and one.is_possible is is_possible]
        if missed:
            named = "; ".join(f"{one.link} {_LETTERS[one.target]} ({one.why})" for one in missed)
            lines += [f"{title}: {named}.", ""]
    return lines[:-1] or ["Every target is met."]


def _details(document: Mapping[str, Any]) -> list[str]:
    figures = figures_of(document)
    keys = [(link["name"], side) for link in document["links"] for side in document["sides"]]
    rows = [[key[0], label(key[1]), *_cells(figures[key])] for key in keys if key in figures]
    return markdown_table("llr", ["link", "side", *(head for head, _, _ in _COLUMNS)], rows)


def _cells(figures: Mapping[str, float]) -> list[str]:
    return [show(figures[name]) if name in figures else "" for _, name, show in _COLUMNS]


def _p99s(figures: Mapping[str, float]) -> str:
    return f"{seconds(figures['latency_p99_s'])} / {seconds(figures['age_p99_s'])}"


def _mark(verdict: Verdict) -> str:
    return "✓" if verdict.is_met else ("✗" if verdict.is_possible else "–")


def _missed(verdict: Verdict) -> str:
    return "MISSED" if verdict.is_possible else "not met, by no side"


def _spread(document: Mapping[str, Any]) -> str:
    """Return the difference between rounds, and how busy the machine was."""
    rounds = max((run["round"] for run in document["runs"]), default=0)
    busy = [run["cpu"]["machine"] for run in document["runs"]]
    machine = f"the machine was {100 * min(busy):.0f} to {100 * max(busy):.0f} % busy" if busy else "nothing ran"
    if starved := sum(share > _STARVED for share in busy):
        machine += f", in {starved} of {len(busy)} runs so much that readers may have starved"
    if rounds < 2:
        return f"One round; {machine}"
    ratios = []
    for link in document["links"]:
        ages = [r["all"]["age_p99_s"] for r in document["runs"] if (r["link"], r["side"]) == (link["name"], ARPD)]
        known = [age for age in ages if age is not None]
        if len(known) > 1:
            ratios.append(max(known) / min(known))
    apart = f"arpd's p99 age differs between rounds by a factor of up to {max(ratios):.2f}" if ratios else ""
    return "; ".join(filter(None, [f"Medians of {rounds} rounds", apart, machine]))


def _apart(document: Mapping[str, Any]) -> str:
    """Return the sides that were measured again after the others, and when."""
    if not (apart := document.get("apart")):
        return ""
    return f" Measured again after the others: {', '.join(map(label, apart['sides']))} ({described(apart)})."


def _slowest(document: Mapping[str, Any]) -> str:
    topics = document["runs"][0]["topics"] if document["runs"] else {}
    name, topic = min(topics.items(), key=lambda item: item[1]["source_rate_hz"], default=("", None))
    return f"{seconds(1.0 / topic['source_rate_hz'])} for {name}" if topic else "no topic"
