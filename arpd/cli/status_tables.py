"""The tables of publishers and readers, as wide as the terminal allows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.cli.client import count, counts, find, number, rows, text
from arpd.cli.columns import cut, fitted
from arpd.model.quantities import format_number, format_period, format_share
from arpd.report.wording import PACED_ONLY

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_LONGEST_NAME = 250


def topic_table(topics: Sequence[dict[str, Any]], *, width: int) -> list[str]:
    """Return a heading and a line per topic, none wider than ``width``; QoS as ``now→planned`` where the two differ."""
    columns: list[tuple[str, int, Callable[[dict[str, Any]], str]]] = [
        ("TOPIC", 0, lambda topic: text(topic, "topic", longest=_LONGEST_NAME)),
        ("NODE", 1, lambda topic: text(topic, "node", longest=_LONGEST_NAME)),
        ("ALLOWED", 0, _allowed),
        ("SENT", 0, lambda topic: format_number(number(topic, "published_rate_hz"))),
        ("SOURCE", 3, lambda topic: format_number(number(topic, "source_rate_hz"))),
        ("DEPTH", 4, lambda topic: _moving(topic, "depth", format_number, missing="-")),
        ("DEADLINE", 5, lambda topic: _moving(topic, "deadline_ns", format_period, missing="none")),
        ("DROPS", 1, _dropped),
        ("CAUSES", 6, _causes),
        ("LATE", 2, _late),
        ("BOUND BY", 0, _bound_by),
    ]
    shown = [column for column in columns if column[0] not in _unknown(topics)]
    grid = [[title for title, _, _ in shown], *([cell(topic) for _, _, cell in shown] for topic in topics)]
    return fitted(grid, ranks=[rank for _, rank, _ in shown], width=width)


def reader_table(status: dict[str, Any], *, width: int) -> list[str]:
    """Return a heading, a line per reader that is planned or refuses to be, and the number of the others."""
    known = rows(status, "readers")
    readers = [reader for reader in known if find(reader, "planned") or text(reader, "refusal")]
    others = f"readers that no plan touches: {len(known) - len(readers)}"
    if not readers:
        return [cut(others, width)] if known else []
    head = ["READER OF", "DEPTH", "planned", "DEADLINE", "planned", "NODE"]
    grid = [head, *(_reader_cells(reader) for reader in readers)]
    if any(count(reader, "deadlines_missed") for reader in readers):
        for cells, title in zip(grid, ("LATE", *map(_late, readers)), strict=True):
            cells.insert(-1, title)
    lines = fitted(grid, ranks=[0, 1, 1, 2, 2, 0, 0][: len(grid[0])], width=width)
    return [*lines, cut(others, width)] if len(readers) < len(known) else lines


def _reader_cells(reader: dict[str, Any]) -> list[str]:
    now, planned = find(reader, "confirmed"), find(reader, "planned")
    node, refusal = text(reader, "node", longest=_LONGEST_NAME), text(reader, "refusal")
    return [
        text(reader, "topic", longest=_LONGEST_NAME),
        format_number(number(now, "depth")),
        format_number(number(planned, "depth")) if planned else "-",
        format_period(number(now, "deadline_ns")),
        format_period(number(planned, "deadline_ns")) if planned else "-",
        f"{node}: {refusal}" if refusal else node,
    ]


def _unknown(topics: Sequence[dict[str, Any]]) -> set[str]:
    """Return the columns without content, and those that an older daemon does not know."""
    nothing = set()
    if len({text(topic, "topic", longest=_LONGEST_NAME) for topic in topics}) == len(topics):
        nothing.add("NODE")
    if not any("published_rate_hz" in topic for topic in topics):
        nothing.add("SENT")
    if not any(count(topic, "deadlines_missed") for topic in topics):
        nothing.add("LATE")
    if not any(_causes(topic) for topic in topics):
        nothing.add("CAUSES")
    return nothing


def _allowed(topic: dict[str, Any]) -> str:
    """Show the rate that the publisher may send at; an older daemon knows no other one than that of the plan."""
    key = "paced_rate_hz" if find(topic, "confirmed", "paced_rate_hz") is not None else "rate_hz"
    rate_hz = number(topic, "confirmed", key)
    return "unpaced" if rate_hz is None else format_number(rate_hz)


def _moving(topic: dict[str, Any], key: str, show: Callable[[float | None], str], *, missing: str) -> str:
    """Show the announced value, and the planned one where the two differ."""
    now, planned = number(topic, "confirmed", key), number(topic, "planned", key)
    shown = missing if now is None else show(now)
    if not find(topic, "planned"):
        return shown
    wanted = missing if planned is None else show(planned)
    return shown if shown == wanted else f"{shown}→{wanted}"


def _dropped(topic: dict[str, Any]) -> str:
    """Show the share of offered messages that the publisher has dropped since it began."""
    withheld, offered = count(topic, "withheld"), count(topic, "offered")
    return format_share(withheld / offered) if offered else str(withheld)


def _causes(topic: dict[str, Any]) -> str:
    return " ".join(f"{cause}:{many}" for cause, many in counts(topic, "withheld_by_cause").items())


def _late(row: dict[str, Any]) -> str:
    return str(count(row, "deadlines_missed")) if "deadlines_missed" in row else "-"


def _bound_by(topic: dict[str, Any]) -> str:
    if refusal := text(topic, "refusal"):
        return f"{PACED_ONLY}: {refusal}" if topic.get("refusal_lasts") else refusal
    return text(topic, "binding").replace("_", " ") or "-"
