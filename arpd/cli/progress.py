"""Progress of long work: a line on a terminal until the work is done, nothing in a pipe."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as Bar
    from rich.progress import TaskID


class Progress:
    """Reports of long work about itself."""

    def __init__(self, bar: Bar, task: TaskID) -> None:
        self._bar, self._task = bar, task
        self._begun = 0

    def step(self, what: str) -> None:
        """Begin the next step, and name it; the steps before it are done."""
        self.reach(self._begun, what)
        self._begun += 1

    def reach(self, done: float, what: str = "") -> None:
        """Say how much is done, in the unit of the total, and perhaps name the present step."""
        self._bar.update(self._task, completed=done)
        if what:
            self._bar.update(self._task, what=what)


@contextmanager
def progress(title: str, *, total: float | None = None) -> Iterator[Progress]:
    """Show progress on stderr where that is a terminal; stdout stays unchanged.

    Parameters
    ----------
    title : name of the work
    total : number of steps, or another measure of the whole; None = unknown
    """
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import TextColumn

    with Bar(
        *Bar.get_default_columns(),
        TextColumn("{task.fields[what]}", markup=False),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
        # rich moves printed text to the bar's stream; that is right only where both go to the same terminal.
        redirect_stdout=sys.stdout.isatty(),
    ) as bar:
        yield Progress(bar, bar.add_task(title, total=total, what=""))
