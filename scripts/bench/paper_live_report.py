"""The report of the paper's robot under arpd: what the uniform policy finds, beside every optimum solved beforehand."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Any

from scripts.bench.paper_cells import FIGURES, LIVE, SENSORS
from scripts.bench.paper_verdict import cells, milliseconds, percent, short
from scripts.bench.report import markdown_table

if TYPE_CHECKING:
    from scripts.bench.paper_verdict import Cell

_HEAD = ("payload B", "", "R Hz", "D", "came Hz", "p50", "p99", "sensing p99", "lost %", "link %")


def live_table(document: dict[str, Any]) -> list[str]:
    """Return the lines of the table as text; none without such turns."""
    if not (rows := _rows(document)):
        return []
    widths = [max(map(len, column)) for column in zip(_HEAD, *rows, strict=True)]
    return [_about(document), *("  ".join(map(str.rjust, row, widths)) for row in (_HEAD, *rows))]


def live_markdown(document: dict[str, Any]) -> list[str]:
    """Return the part of docs/results.md; none without such turns."""
    rows = _rows(document)
    return [_about(document), "", *markdown_table("rlr", _HEAD, rows)] if rows else []


def _about(document: dict[str, Any]) -> str:
    links = ", ".join(dict.fromkeys(cell.link for cell in cells(document, LIVE)))
    rates = ", ".join(dict.fromkeys(str(cell.deadline_hz) for cell in cells(document, LIVE)))
    return (
        f"The same robot under `arpd run` with `policy: uniform` over {links}, beside the optima solved beforehand, "
        f"each for an Rmax that somebody guessed. arpd measures Rmax. Its sources publish at {rates} Hz; what pacing "
        "withholds is not lost. R and D are medians of the measured time; came: samples of one sensor that reached the "
        "planner. Latency is end to end, in ms (range over rounds). arpd's publishers have its Fast DDS profile, the "
        "others rclpy's default."
    )


def _rows(document: dict[str, Any]) -> list[list[str]]:
    rows = []
    for live in cells(document, LIVE):
        static = [cell for cell in cells(document, FIGURES) if _is_beside(cell, live)]
        rows.append(_row(live, "arpd", *_found(live), document))
        for known in document["optima"]:
            rows += [
                _row(cell, f"Rmax {known['rmax_hz']}", str(cell.deadline_hz), str(cell.depth), document)
                for cell in static
                if (cell.deadline_hz, cell.depth) == (known["rate_hz"], known["depth"])
            ]
    return rows


def _is_beside(cell: Cell, live: Cell) -> bool:
    return (cell.link, cell.payload_bytes) == (live.link, live.payload_bytes)


def _found(live: Cell) -> tuple[str, str]:
    """Return R and D as arpd found them, with Rmax."""
    if not live.runs:
        return "–", "–"
    rate_hz, max_rate_hz, depth = (
        median(run["uniform"][key] for run in live.runs) for key in ("rate_hz", "max_rate_hz", "depth")
    )
    return f"{short(rate_hz)} (Rmax {short(max_rate_hz)})", f"{depth:.0f}"


def _row(cell: Cell, name: str, rate: str, depth: str, document: dict[str, Any]) -> list[str]:
    head = [str(cell.payload_bytes), name, rate, depth]
    if not cell.runs:
        return [*head, cell.why_void, *[""] * (len(_HEAD) - len(head) - 1)]
    came_hz = median(run["sensing"]["count"] for run in cell.runs) / SENSORS / document["conditions"]["seconds"]
    between = f" ({'–'.join(map(milliseconds, cell.p99_range_s))})" if len(cell.runs) > 1 else ""
    return [
        *head,
        short(came_hz),
        milliseconds(cell.p50_s),
        f"{milliseconds(cell.p99_s)}{between}",
        milliseconds(cell.middle("sensing", "p99_s")),
        percent(cell.lost_ratio),
        percent(cell.used_ratio),
    ]
