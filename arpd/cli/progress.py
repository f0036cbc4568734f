"""Progress of long work: a line on a terminal that goes when the work is done, nothing in a pipe."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as Bar
    from rich.progress import TaskID


class Progress(Protocol):
    """What long work tells of itself."""

    def step(self, what: str) -> None:
        """Say that the next step begins, and what it is; those before it are done."""

    def reach(self, done: float, what: str = "") -> None:
        """Say how much is done, in the unit of the total, and perhaps what comes now."""


@contextmanager
def progress(title: str, *, total: float | None = None) -> Iterator[Progress]:
    """Show how work goes on, on stderr, and only where that is a terminal; stdout stays what it was.

    Parameters
    ----------
    title : what is being done
    total : number of steps, or any other measure of the whole; None where nobody knows
    """
    if not sys.stderr.isatty():
        yield _Quiet()
        return
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    with Bar(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[what]}", markup=False, style="dim"),
        TimeElapsedColumn(),
        *([] if total is None else [TimeRemainingColumn(elapsed_when_finished=True)]),
        console=Console(stderr=True),
        transient=True,
        # rich would move what is printed to the bar's stream; only what goes to the same terminal may move.
        redirect_stdout=sys.stdout.isatty(),
        refresh_per_second=4,
    ) as bar:
        yield _Shown(bar, bar.add_task(title, total=total, what=""))


class _Shown:
    def __init__(self, bar: Bar, task: TaskID) -> None:
        self._bar, self._task = bar, task
        self._begun = 0

    def step(self, what: str) -> None:
        self.reach(self._begun, what)
        self._begun += 1

    def reach(self, done: float, what: str = "") -> None:
        self._bar.update(self._task, completed=done)
        if what:
            self._bar.update(self._task, what=what)


class _Quiet:
    def step(self, what: str) -> None:
        pass

    def reach(self, done: float, what: str = "") -> None:
        pass
