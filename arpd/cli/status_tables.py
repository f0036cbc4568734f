"""The table of publishers, the topics that need a look first."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.cli.client import count, counts, find, number, text
from arpd.cli.fitted_table import FittedTable
from arpd.model.quantities import format_number, format_period, format_share
from arpd.report.situation import SLOWED_BELOW
from arpd.report.wording import PACED_ONLY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

_LONGEST_NAME = 250


def pressing_first(topics: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Order by what an operator looks for: refusals, then topics that give up most, then those that use most."""
    return sorted(topics, key=_rank)


def is_slowed(topic: dict[str, Any]) -> bool:
    """Return whether the link keeps a topic below its source's rate."""
    return _kept_ratio(topic) < SLOWED_BELOW


def topic_table(topics: Sequence[dict[str, Any]]) -> FittedTable:
    """Return a heading and a line per topic; QoS as ``now→planned`` where the two differ."""
    columns: list[tuple[str, int, Callable[[dict[str, Any]], str]]] = [
        ("TOPIC", 0, lambda topic: text(topic, "topic", longest=_LONGEST_NAME)),
        ("NODE", 1, lambda topic: text(topic, "node", longest=_LONGEST_NAME)),
        ("ALLOWED", 0, _allowed),
        ("SENT", 0, lambda topic: format_number(number(topic, "published_rate_hz"))),
        ("SOURCE", 3, lambda topic: format_number(number(topic, "source_rate_hz"))),
        ("DEPTH", 4, lambda topic: _moving(topic, "depth", format_number, missing="-")),
        ("DEADLINE", 5, lambda topic: _moving(topic, "deadline_ns", format_period, missing="none")),
        ("WITHHELD", 1, _withheld),
        ("CAUSES", 6, _causes),
        ("LATE", 2, _late),
        ("BOUND BY", 0, _bound_by),
    ]
    nothing = _unknown(topics)
    titles, ranks, cells = zip(*(column for column in columns if column[0] not in nothing), strict=True)
    rows = [titles, *([cell(topic) for cell in cells] for topic in topics)]
    return FittedTable(rows=rows, ranks=ranks, styles=[_style(topic) for topic in topics])


def _rank(topic: dict[str, Any]) -> tuple[bool, float, float, str, str]:
    return (
        not _is_refused(topic),
        _kept_ratio(topic) if is_slowed(topic) else 1.0,
        -(number(topic, "share") or 0.0),
        text(topic, "topic"),
        text(topic, "node"),
    )


def _kept_ratio(topic: dict[str, Any]) -> float:
    kept = number(topic, "kept_ratio")
    return 1.0 if kept is None else kept  # an older daemon does not say


def _is_refused(topic: dict[str, Any]) -> bool:
    return bool(text(topic, "refusal")) and not topic.get("refusal_lasts")


def _style(topic: dict[str, Any]) -> str:
    if _is_refused(topic):
        return "red"
    if is_slowed(topic):
        return "yellow"
    return "" if topic.get("planned") else "dim"


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


def _moving(row: dict[str, Any], key: str, show: Callable[[float | None], str], *, missing: str) -> str:
    """Show the announced value, and the planned one where the two differ."""
    now, planned = number(row, "confirmed", key), number(row, "planned", key)
    shown = missing if now is None else show(now)
    if not find(row, "planned"):
        return shown
    wanted = missing if planned is None else show(planned)
    return shown if shown == wanted else f"{shown}→{wanted}"


def _withheld(topic: dict[str, Any]) -> str:
    """Show the share of offered messages that the publisher has withheld since it began."""
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
