"""Lines and columns that commands print: aligned, cut, wrapped."""

from __future__ import annotations

import textwrap
import time
from typing import TYPE_CHECKING

from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

WITHOUT_END = 10_000  # columns, or lines, of a pipe
_LONGEST_NAME = 32  # fits a line of 120 columns


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


def from_end(text: str, longest: int) -> str:
    """Keep the end of a text that is too long."""
    return text if len(text) <= longest else f"…{text[1 - longest :]}" if longest > 1 else "…"


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


def wall_clock(unix_time_s: float | None, pattern: str = "%H:%M:%S") -> str:
    """Return a Unix time as local time, question marks for a time outside the calendar."""
    try:
        return "??:??:??" if unix_time_s is None else time.strftime(pattern, time.localtime(unix_time_s))
    except (OverflowError, ValueError, OSError):
        return "??:??:??"
