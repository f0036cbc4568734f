"""Lines and columns that commands print: aligned, fitted to a terminal, cut, wrapped."""

from __future__ import annotations

import textwrap
import time
from typing import TYPE_CHECKING, Any

from arpd.cli.client import number, rows, text
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

WITHOUT_END = 10_000  # columns, or lines, of a pipe
_LONGEST_NAME = 32  # fits a line of 120 columns
# A first column up to _WHOLE_NAME wide is worth more than a column of rank 5; the others keep it and the last readable.
_WHOLE_NAME, _LEAST_NAME, _LEAST_LAST = 40, 20, 8


def aligned(rows: Sequence[Sequence[str]], *, words: int) -> list[str]:
    """Put cells into columns: the first and the last ``words`` flush left, numbers flush right."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    numbers = len(widths) - words
    lines = []
    for row in rows:
        cells = [
            text.rjust(width) if 0 < column < numbers else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join([" ".join(cells[:numbers]), *cells[numbers:]]).rstrip())
    return lines


def short_name(name: str, *, longest: int = _LONGEST_NAME) -> str:
    """Cut the front off a long name; its end tells topics apart."""
    return from_end(printable(name, longest=250), longest)


def fitted(rows: Sequence[Sequence[str]], *, ranks: Sequence[int], width: int) -> list[str]:
    """Put rows into columns, none wider than ``width``; all columns but the first and the last hold numbers.

    Where they are too wide it drops columns of rank 5 and more, then cuts the front of the first column (the end tells
    topics apart), then drops further columns, the highest rank first, then cuts the end of the last column.

    Parameters
    ----------
    ranks : one per column; 0 is never dropped
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    kept = list(range(len(widths)))

    def excess(longest_name: int) -> int:
        least = min(widths[0], longest_name) + min(widths[-1], _LEAST_LAST)
        return least + sum(widths[column] for column in kept[1:-1]) + 2 * (len(kept) - 1) - width

    for longest_name, lowest_rank in ((_WHOLE_NAME, 5), (_LEAST_NAME, 1)):
        while excess(longest_name) > 0 and any(ranks[column] >= lowest_rank for column in kept):
            kept.remove(max(kept, key=lambda column: ranks[column]))
    room = width - sum(widths[column] for column in kept[1:-1]) - 2 * (len(kept) - 1)
    widths[0] = max(min(widths[0], _LEAST_NAME), min(widths[0], room - widths[-1]))
    last = max(1, room - widths[0])
    lines = []
    for row in rows:
        numbers = (row[column].rjust(widths[column]) for column in kept[1:-1])
        lines.append("  ".join((from_end(row[0], widths[0]).ljust(widths[0]), *numbers, cut(row[-1], last))).rstrip())
    return lines


def from_end(text: str, longest: int) -> str:
    """Keep the end of a text that is too long."""
    return text if len(text) <= longest else f"…{text[1 - longest :]}" if longest > 1 else "…"


def cut(text: str, longest: int) -> str:
    """Keep the beginning of a text that is too long."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def wrapped(text: str, width: int, *, indent: int, most: int = 2) -> list[str]:
    """Break a text into ``most`` lines, the second and later ones indented; an ellipsis stands for the rest."""
    return textwrap.wrap(
        text,
        max(width, 3 * indent, 20),
        subsequent_indent=" " * indent,
        max_lines=most,
        placeholder=" …",
        break_on_hyphens=False,
    )


_DAY_S = 86_400.0


def last_events(status: dict[str, Any], most: int, *, width: int) -> list[str]:
    """Return the last events, oldest first, none wider than ``width``; those of another day with their date."""
    events = rows(status, "events")
    now_s = number(status, "unix_time_seconds")
    return [cut(f"{clock(event, now_s)}  {text(event, 'text')}", width) for event in events[-most:]] if most > 0 else []


def clock(event: dict[str, Any], now_s: float | None = None) -> str:
    """Return the local time of an event."""
    at_s = number(event, "unix_time_seconds")
    is_recent = at_s is not None and (now_s is None or abs(now_s - at_s) < _DAY_S)
    return wall_clock(at_s, "%H:%M:%S" if is_recent else "%b %d %H:%M")


def wall_clock(unix_time_s: float | None, pattern: str = "%H:%M:%S") -> str:
    """Return a Unix time as local time, question marks for a time outside the calendar."""
    try:
        return "??:??:??" if unix_time_s is None else time.strftime(pattern, time.localtime(unix_time_s))
    except (OverflowError, ValueError, OSError):
        return "??:??:??"
