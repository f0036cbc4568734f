"""A status document as `arpd status` prints it, or `arpd top` shows it, with nothing asked of a daemon."""

from __future__ import annotations

import io

from rich.console import Console

from arpd.cli.client import read_history, read_status
from arpd.cli.frame import Frame
from arpd.cli.output import WITHOUT_END


def printed(status, history=None, *, width=WITHOUT_END, **said):
    """Print a frame; returns its lines."""
    return _lines(_frame(status, history, **said), width, WITHOUT_END)


def on_screen(status, history=None, *, width=110, height=40, **said):
    """Draw a frame for a screen; returns its lines, also those that a screen would cut off."""
    return _lines(_frame(status, history, is_on_screen=True, **said), width, height)


def _frame(status, history, **said):
    return Frame(status=read_status(status, source="-"), history=read_history(history), **said)


def _lines(shown, width, height):
    written = io.StringIO()
    Console(width=width, height=height, file=written, force_terminal=False).print(shown)
    return [line.rstrip() for line in written.getvalue().splitlines()]
