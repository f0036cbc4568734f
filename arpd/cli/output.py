"""Standard output as rich writes to it: tables that fit the width they are printed in, and texts that are wrapped."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import ConsoleOptions, RenderableType
    from rich.segment import Segment

WITHOUT_END = 10_000  # columns, or lines, of a pipe
_GAP = 2
_LEAST_NAME, _LEAST_LAST = 24, 8  # of the first and the last column, while another one can be dropped instead


def width_of_output() -> int:
    """Return the width of standard output, which may lack characters: a pipe's has no end unless COLUMNS gives one."""
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]
    return shutil.get_terminal_size((WITHOUT_END, WITHOUT_END)).columns


def show(*parts: RenderableType) -> None:
    """Print to standard output: with colours on a terminal, no line wider than it, or than COLUMNS says."""
    console = Console(width=width_of_output(), height=WITHOUT_END, highlight=False)
    with console.capture() as drawn:
        for part in parts:
            console.print(part)
    print("\n".join(line.rstrip() for line in drawn.get().splitlines()))


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


@dataclass(frozen=True, kw_only=True, slots=True)
class FittedTable:
    """Rows in columns, for rich to print.

    Where they are too wide it cuts the front of the first column (the end tells topics apart) and the end of the last
    one, to 24 and 8 characters, then drops columns, the highest rank first, then cuts on.

    Parameters
    ----------
    rows : of equally many cells, the headings first, which may have two lines
    ranks : one per column; 0 is never dropped, as none is without any
    words : headings of columns that are flush left, as the first one is; the others hold numbers
    styles : of each row after the headings, without any by default
    """

    rows: Sequence[Sequence[str]]
    ranks: Sequence[int] = ()
    words: frozenset[str] = frozenset()
    styles: Sequence[str] = ()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Segment]:
        """Yield the table that fits."""
        widths = [max(map(_width, column)) for column in zip(*self.rows, strict=True)]
        kept = self._kept(widths, options.max_width)
        first, last = kept[0], kept[-1]
        room = options.max_width - sum(widths[column] + _GAP for column in kept[1:-1]) - _GAP
        widths[first] = max(min(widths[first], _LEAST_NAME), min(widths[first], room - widths[last]))
        widths[last] = max(1, min(widths[last], room - widths[first]))
        table = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="bold underline")
        for column in kept:
            heading = self.rows[0][column]
            is_number = column != first and heading not in self.words
            table.add_column(
                Text(heading), justify="right" if is_number else "left", no_wrap=True, width=widths[column]
            )
        for row, style in zip(self.rows[1:], self.styles or [""] * len(self.rows), strict=False):
            name = _from_end(row[first], widths[first])
            table.add_row(*map(Text, (name, *(row[column] for column in kept[1:]))), style=style)
        # Before rich 15 a table counts the gap that it leaves out after the last column.
        yield from console.render(table, options.update_width(options.max_width + _GAP))

    def _kept(self, widths: Sequence[int], width: int) -> list[int]:
        kept = list(range(len(widths)))

        def excess() -> int:
            least = min(widths[0], _LEAST_NAME) + min(widths[-1], _LEAST_LAST)
            return least + sum(widths[column] for column in kept[1:-1]) + _GAP * (len(kept) - 1) - width

        while self.ranks and excess() > 0 and any(self.ranks[column] for column in kept):
            kept.remove(max(kept, key=self.ranks.__getitem__))
        return kept


def _width(text: str) -> int:
    return max(map(cell_len, text.split("\n")))


def _from_end(text: str, longest: int) -> str:
    """Keep the end of a text that is too long."""
    return text if len(text) <= longest else f"…{text[1 - longest :]}" if longest > 1 else "…"
