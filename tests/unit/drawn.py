"""A status document as `arpd status` prints it, or `arpd top` shows it, with nothing asked of a daemon."""

import io

from rich.console import Console

from arpd.cli.client import read_history, read_status
from arpd.cli.frame import Frame
from arpd.cli.output import WITHOUT_END


def printed(status, history=None, *, width=WITHOUT_END, **said):
    """Print a frame; returns its lines."""
    written = io.StringIO()
    shown = Frame(status=read_status(status, source="-"), history=read_history(history), **said)
    Console(width=width, height=WITHOUT_END, file=written, force_terminal=False).print(shown)
    return [line.rstrip() for line in written.getvalue().splitlines()]
