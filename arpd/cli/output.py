"""Standard output as rich writes to it, and a table that fits the width it is printed in."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from arpd.cli.columns import WITHOUT_END, from_end

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import ConsoleOptions, RenderableType
    from rich.segment import Segment

_GAP = 2
# A first column up to _WHOLE_NAME wide is worth more than a column of rank 5; the others keep it and the last readable.
_WHOLE_NAME, _LEAST_NAME, _LEAST_LAST = 40, 20, 8


def show(shown: RenderableType) -> None:
    """Print to standard output: with colours on a terminal, no line wider than it, or than COLUMNS says."""
    width, height = shutil.get_terminal_size((WITHOUT_END, WITHOUT_END))
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr] # a terminal may lack a character
    console = Console(width=width, height=height, highlight=False)
    with console.capture() as drawn:
        console.print(shown)
    print("\n".join(line.rstrip() for line in drawn.get().splitlines()))


@dataclass(frozen=True, kw_only=True, slots=True)
class FittedTable:
    """Rows in columns, for rich to print.

    Where they are too wide it drops columns of rank 5 and more, then cuts the front of the first column (the end tells
    topics apart), then drops further columns, the highest rank first, then cuts the end of the last column.

    Parameters
    ----------
    rows : of equally many cells, the headings first
    ranks : one per column; 0 is never dropped
    words : headings of columns between the first and the last that are flush left; the others there hold numbers
    styles : of each row after the headings, without any by default
    """

    rows: Sequence[Sequence[str]]
    ranks: Sequence[int]
    words: frozenset[str] = frozenset()
    styles: Sequence[str] = ()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Segment]:
        """Yield the table that fits."""
        widths = [max(cell_len(row[column]) for row in self.rows) for column in range(len(self.ranks))]
        kept = self._kept(widths, options.max_width)
        first, last = kept[0], kept[-1]
        room = options.max_width - sum(widths[column] + _GAP for column in kept[1:-1]) - _GAP
        widths[first] = max(min(widths[first], _LEAST_NAME), min(widths[first], room - widths[last]))
        widths[last] = max(1, min(widths[last], room - widths[first]))
        table = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="bold underline")
        for column in kept:
            heading = self.rows[0][column]
            is_number = column not in {first, last} and heading not in self.words
            table.add_column(
                Text(heading), justify="right" if is_number else "left", no_wrap=True, width=widths[column]
            )
        for row, style in zip(self.rows[1:], self.styles or [""] * len(self.rows), strict=False):
            name = from_end(row[first], widths[first])
            table.add_row(*map(Text, (name, *(row[column] for column in kept[1:]))), style=style)
        # Before rich 15 a table counts the gap that it leaves out after the last column.
        yield from console.render(table, options.update_width(options.max_width + _GAP))

    def _kept(self, widths: Sequence[int], width: int) -> list[int]:
        kept = list(range(len(widths)))

        def excess(longest_name: int) -> int:
            least = min(widths[0], longest_name) + min(widths[-1], _LEAST_LAST)
            return least + sum(widths[column] for column in kept[1:-1]) + _GAP * (len(kept) - 1) - width

        for longest_name, lowest_rank in ((_WHOLE_NAME, 5), (_LEAST_NAME, 1)):
            while excess(longest_name) > 0 and any(self.ranks[column] >= lowest_rank for column in kept):
                kept.remove(max(kept, key=lambda column: self.ranks[column]))
        return kept
