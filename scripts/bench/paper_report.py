"""The report of the paper's experiment: the figures of each configuration, and whether the optimum wins."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import ARPD, DEFAULT, FIGURES, HEARTBEAT_S, LIVE, LOSS
from scripts.bench.paper_live_report import live_markdown, live_table
from scripts.bench.paper_summary import REACHED_RATIO
from scripts.bench.paper_verdict import LIKE, Cell, cells, milliseconds, misses, percent, rounds, verdicts
from scripts.bench.record import described
from scripts.bench.report import markdown_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scripts.bench.paper_verdict import Verdict


def nonsense(document: dict[str, Any]) -> list[str]:
    """Return the faults that make the document worthless; void turns are not faults."""
    if not document["runs"]:
        return ["no turn came to its end"]
    found = []
    for run in document["runs"]:
        name = f"{run['link']}, {_named(run)}"
        if "failed" in run:
            found.append(f"{name}: {run['failed']}")
            continue
        if not run["sensing"]["count"]:
            found.append(f"{name}: nothing arrived")
        elif not run["end_to_end"]["count"] and run["sensing"]["lost_ratio"] < 0.5:
            found.append(f"{name}: nothing was answered")
        if run["robot_sent_bytes"] < run["sensing"]["count"] * run["payload_bytes"]:
            found.append(f"{name}: more arrived than the link carried; it was bypassed")
        if any(not math.isfinite(number) for number in _numbers(run)):
            found.append(f"{name}: a figure is not a number")
    return found


def voids(document: dict[str, Any]) -> list[str]:
    """Return the void turns, and the processes without CPU time."""
    return [
        f"{run['link']}, {_named(run)}, round {run['round']}: the {run['void']} could not keep up"
        for run in document["runs"]
        if run.get("void")
    ]


def table(document: dict[str, Any]) -> str:
    """Return every configuration's figures, the verdicts, the cost of a lost packet, and the figures under arpd."""
    head = (
        f"{'link':>8} {'B':>5} {'Hz':>5} {'DEPTH':>5} {'mean ms':>9} {'p50':>9} {'p95':>9} {'p99 ms':>27}"
        f" {'sensing p99':>11} {'lost %':>7} {'unanswered':>10} {'rate %':>7} {'blocked':>7} {'link %':>6}"
    )
    what = "end to end: median over rounds (range); rate: of what was asked for, blocked: of the time, in publish()"
    rows = [what, head]
    for cell in cells(document, FIGURES):
        name = f"{cell.link:>8} {cell.payload_bytes:>5} {cell.deadline_hz:>5} {cell.depth:>5}"
        if not cell.runs:
            rows.append(f"{name} {cell.why_void}")
            continue
        mean, p50, p95 = (milliseconds(cell.middle("end_to_end", key)) for key in ("mean_s", "p50_s", "p95_s"))
        sensing = milliseconds(cell.middle("sensing", "p99_s"))
        shares = (cell.middle(*keys) for keys in (("end_to_end", "lost_ratio"), ("reached_ratio",), ("blocked_ratio",)))
        unanswered, reached, blocked = map(percent, shares)
        rows.append(
            f"{name} {mean:>9} {p50:>9} {p95:>9} {_shown_p99(cell):>27} {sensing:>11} {percent(cell.lost_ratio):>7}"
            f" {unanswered:>10} {reached:>7} {blocked:>7} {percent(cell.used_ratio):>6}"
        )
    return "\n".join([*rows, "", *_judged(document), "", *_loss_table(document), "", *live_table(document)])


def markdown(document: dict[str, Any]) -> str:
    """Return the block of docs/results.md."""
    links = "; ".join(
        f"{link['name']}: {link['rate_bytes_per_second'] * 8 / 1e6:g} Mbit/s, queue {link['queue_bytes'] / 1e3:g} kB, "
        f"loss {percent(link['loss'])} %"
        for link in document["links"]
    )
    head = (
        f"{rounds(document)} a configuration; {described(document)}. Links: {links} "
        "(the rest of Wi-Fi's frame errors after seven attempts). Latency is end to end, "
        "sensor → planner → actuator, in ms (range over rounds); lost is the share of all samples of the twelve "
        "topics. Void: this machine could not generate the load, or not answer it."
    )
    titles = [
        *("link", "payload B", "Rmax Hz", "optimum R Hz, D", "p50", "p99", "lost %"),
        *("DEPTH 1 at Rmax: p99", "lost %", "DEPTH 5000 at Rmax: p99", "lost %", "rate reached %"),
    ]
    lines = [
        *(head, "", *_judged(document), ""),
        *("<details><summary>Every optimum beside the fixed configurations at its Rmax</summary>", ""),
        *markdown_table("lr", titles, map(_row, verdicts(document))),
        *("", "</details>", "", *_loss_markdown(document)),
    ]
    if live := live_markdown(document):
        lines += ["", *live]
    return "\n".join(lines)


def _row(verdict: Verdict) -> list[str]:
    best, (shallow, deep) = verdict.optimum, verdict.at_rmax
    return [
        *(best.link, str(best.payload_bytes), str(verdict.rmax_hz), f"{best.deadline_hz}, {best.depth}"),
        *(milliseconds(best.p50_s), _shown_p99(best), percent(best.lost_ratio)),
        *(_shown_p99(shallow), percent(shallow.lost_ratio)),
        *(_shown_p99(deep), percent(deep.lost_ratio), percent(deep.middle("reached_ratio"))),
    ]


def _judged(document: dict[str, Any]) -> list[str]:
    """Return how many optima meet both targets, and the reason for each that does not."""
    found = verdicts(document)
    judged = [each for each in found if each.optimum.runs]
    lines = []
    for link in dict.fromkeys(each.optimum.link for each in judged):
        here = [each for each in judged if each.optimum.link == link]
        quick, safe = sum(not each.slower_than for each in here), sum(not each.lossier_than for each in here)
        lines.append(
            f"- {link}: p99 of the optimum below that of every fixed configuration that loses nothing: {quick} of "
            f"{len(here)} (payload × Rmax); loss not above that of any with a like latency (p99 within a factor "
            f"{LIKE:g}): {safe} of {len(here)}."
        )
        lines += [f"  - Missed: {miss}" for miss in misses(document, here)]
    lines += [*_held_back(cells(document, FIGURES)), *_overflowed(cells(document, FIGURES))]
    if void := [each.optimum for each in found if not each.optimum.runs]:
        lines.append(f"- No verdict on {', '.join(f'{c.link} {c.name}' for c in void)}: void.")
    if void := [cell for cell in cells(document, FIGURES) if not cell.runs]:
        lines.append(f"- Void: {'; '.join(f'{c.link} {c.name} ({c.why_void})' for c in void)}.")
    return lines


def _held_back(found: list[Cell]) -> list[str]:
    """Name the configurations whose sensors did not keep their rate although this machine could."""
    slowed = [cell for cell in found if (cell.middle("reached_ratio") or 1.0) < REACHED_RATIO]
    if not slowed:
        return []
    worst = min(slowed, key=lambda cell: cell.middle("reached_ratio") or 0.0)
    sentence = (
        f"- In {len(slowed)} of {len(found)} configurations publish() blocked so long that sensors reached less than "
        f"{percent(REACHED_RATIO)} % of their rate; the least is {percent(worst.middle('reached_ratio'))} %, with "
        f"{worst.link} {worst.name}, the link {percent(worst.used_ratio)} % full."
    )
    return [sentence]


def _overflowed(found: list[Cell]) -> list[str]:
    """Name the configurations in which this machine lost packets that the link had carried."""
    if not (flooded := [cell for cell in found if cell.overflows]):
        return []
    worst = max(flooded, key=lambda cell: cell.overflows)
    sentence = (
        f"- In {len(flooded)} of {len(found)} configurations a reader's socket overflowed; this machine causes that, "
        f"not the link. The most datagrams, {worst.overflows}, were lost with {worst.link} {worst.name}."
    )
    return [sentence]


def _loss_cells(document: dict[str, Any]) -> Iterator[tuple[float, list[Cell]]]:
    """Yield each loss of the link with its configurations: by heartbeat, the optimum before the deeper one."""
    found = cells(document, LOSS)
    for loss in sorted({cell.link_loss for cell in found}):
        here = [cell for cell in found if cell.link_loss == loss]
        yield loss, sorted(here, key=lambda cell: ((DEFAULT, ARPD).index(cell.heartbeat), cell.depth))


def _loss_table(document: dict[str, Any]) -> list[str]:
    return [
        f"loss {percent(loss):>5} %, {cell.heartbeat:>15} heartbeat, {cell.name}: p50 "
        f"{milliseconds(cell.p50_s)} ms, p99 {_shown_p99(cell)} ms, lost {percent(cell.lost_ratio)} %"
        for loss, found in _loss_cells(document)
        for cell in found
    ]


def _loss_markdown(document: dict[str, Any]) -> list[str]:
    table_of = list(_loss_cells(document))
    if not table_of:
        return []
    columns = table_of[0][1]
    what = (
        f"The cost of a lost packet, {columns[0].payload_bytes} B over {columns[0].link}: p50, p99 in ms (range over "
        f"rounds) of the optimum and of the same rate at the largest DEPTH, with rclpy's heartbeat of "
        f"{HEARTBEAT_S[DEFAULT]:g} s and the {milliseconds(HEARTBEAT_S[ARPD])} ms of arpd's Fast DDS profile."
    )
    head = ["packets lost %", *(f"{cell.heartbeat}: {cell.name_in_link}" for cell in columns)]
    rows = (
        [percent(loss), *(f"{milliseconds(cell.p50_s)}, {_shown_p99(cell)}" for cell in found)]
        for loss, found in table_of
    )
    return [what, "", *markdown_table("r", head, rows)]


def _shown_p99(cell: Cell) -> str:
    """Return the p99, of several rounds with their range in brackets."""
    if not cell.runs:
        return cell.why_void
    between = f" ({'–'.join(map(milliseconds, cell.p99_range_s))})" if len(cell.runs) > 1 else ""
    return f"{milliseconds(cell.p99_s)}{between}"


def _named(run: dict[str, Any]) -> str:
    if run["experiment"] == LIVE:
        return f"{run['payload_bytes']} B under arpd"
    return f"{run['payload_bytes']} B at {run['deadline_hz']} Hz, DEPTH {run['depth']}"


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        for each in value.values():
            yield from _numbers(each)
    elif isinstance(value, float):
        yield value
