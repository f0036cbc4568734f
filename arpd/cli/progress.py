"""Progress of long work: a line on a terminal until the work is done, nothing in a pipe."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress, TextColumn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def progress(title: str, *, total: float | None = None) -> Iterator[Callable[[float, str], None]]:
    """Show progress on stderr where that is a terminal; stdout stays unchanged.

    Parameters
    ----------
    title : name of the work
    total : number of steps, or another measure of the whole; None = unknown

    Yields
    ------
    A function that takes how much is done, in the unit of the total, and the name of the present step.
    """
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
