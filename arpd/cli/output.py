"""Standard output as rich writes to it: tables that fit the width they are printed in, wrapped texts, progress."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

WITHOUT_END = 10_000  # columns, or lines, of a pipe
_GAP = 2
_LEAST_NAME, _LEAST_LAST = 24, 8  # of the first and the last column, while another one can be dropped instead


def width_of_output() -> int:
    """Return the width of standard output: a pipe's has no end unless COLUMNS gives one."""
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


def wall_clock(unix_time_s: float, pattern: str = "%H:%M:%S") -> str:
    """Return a Unix time as local time, question marks for a time outside the calendar."""
    try:
        return time.strftime(pattern, time.localtime(unix_time_s))
    except (OverflowError, ValueError, OSError):
        return "??:??:??"


def fitted(
    rows: Sequence[Sequence[str]],
    width: int = 0,
    *,
    ranks: Sequence[int] = (),
    words: Collection[str] = (),
    styles: Sequence[str] = (),
) -> Table:
    """Lay rows out in columns that fit a width.

    Where they are too wide, columns are dropped, those of the highest rank first, once the first column has 24
    characters and the last one 8. A first cell that is too long loses its front (the end tells topics apart), a last
    one its end.

    Parameters
    ----------
    rows : of equally many cells, the headings first, which may have two lines
    width : of the place for it, by default that of standard output (columns)
    ranks : one per column; 0 is never dropped, as none is without any
    words : headings of columns that are flush left, as the first one is; the others hold numbers
    styles : of each row after the headings, without any by default
    """
    width = width or width_of_output()
    widths = [max(cell_len(line) for cell in column for line in cell.split("\n")) for column in zip(*rows, strict=True)]
    least = [min(widths[0], _LEAST_NAME), *widths[1:-1], min(widths[-1], _LEAST_LAST)]
    kept = list(range(len(widths)))
    for rank in sorted({*ranks} - {0}, reverse=True):
        if sum(least[column] + _GAP for column in kept) > width + _GAP:
            kept = [column for column in kept if ranks[column] != rank]
    room = max(least[0], width - sum(least[column] + _GAP for column in kept[1:]))
    table = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="bold underline")
    for column in kept:
        heading = rows[0][column]
        is_left = column == 0 or heading in words
        table.add_column(Text(heading), justify="left" if is_left else "right", no_wrap=column != kept[-1])
    for row, style in zip(rows[1:], styles or [""] * len(rows), strict=False):
        name = row[0] if len(row[0]) <= room else f"…{row[0][1 - room :]}"
        table.add_row(
            *(Text(cell, no_wrap=True) for cell in (name, *(row[column] for column in kept[1:]))), style=style
        )
    return table


@contextmanager
def progress(title: str, *, total: float | None = None) -> Iterator[Callable[[float, str], None]]:
    """Show progress on stderr until the work is done, where that is a terminal; stdout stays unchanged.

    Parameters
    ----------
    title : name of the work
    total : number of steps, or another measure of the whole; None = unknown

    Yields
    ------
    A function that takes how much is done, in the unit of the total, and the name of the present step.
    """
    from rich.progress import Progress, TextColumn

    with Progress(
        *Progress.get_default_columns(),
        TextColumn("{task.fields[what]}", markup=False),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
        # rich moves printed text to the bar's stream; that is right only where both go to the same terminal.
        redirect_stdout=sys.stdout.isatty(),
    ) as bar:
        task = bar.add_task(title, total=total, what="")
        yield lambda done, what: bar.update(task, completed=done, what=what)
