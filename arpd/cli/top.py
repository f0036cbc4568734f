"""`arpd top`: the frame of `arpd status`, live on a terminal's whole screen."""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import termios
import time
import tty
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.live import Live

from arpd.cli.client import connect
from arpd.cli.frame import Frame
from arpd.cli.options import Command, add_address, within
from arpd.model.errors import ArpdError, UsageError

if TYPE_CHECKING:
    import argparse

    from rich.console import RenderableType

    from arpd.cli.client import Daemon

_QUIT_KEYS = b"qQ\x03"
_LEAST_INTERVAL_S, _MOST_INTERVAL_S = 0.2, 3600.0
_HISTORY_EVERY_S = 10.0  # a sparkline shows ten minutes in fewer than 60 columns
_REDRAW_S = 1.0  # the age of a silent daemon's answer counts up
_TEXT = """\
Show live what `arpd status` prints once. Topics that do not fit the terminal are counted.
q or Ctrl-C ends it. It waits for a daemon that goes away.

examples:
  arpd top
  arpd top --url http://robot.local:9464 --interval 5
  ARPD_PASSWORD=… arpd top --url https://robot.local:9464 --cacert ca.crt --user robot

exit codes: 0 ended by you, 2 wrong usage, 3 no daemon answers at the start"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_address(parser)
    interval = within(_LEAST_INTERVAL_S, _MOST_INTERVAL_S, parse=float)
    parser.add_argument(
        "--interval", type=interval, default=1.0, metavar="S", help="seconds between updates (default 1)"
    )


def _top(options: argparse.Namespace) -> int:
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") in {"dumb", "unknown"}:
        raise UsageError("arpd top needs a terminal; arpd status prints the same once")
    with connect(options) as daemon:
        _watch(daemon, interval_s=options.interval)
    return 0


def _watch(daemon: Daemon, *, interval_s: float) -> None:
    """Show a daemon on the terminal until the user ends it.

    Parameters
    ----------
    interval_s : pause between two questions (s)

    Raises
    ------
    DaemonUnreachableError
        If it does not answer at the start; later this waits for it.
    """
    seen = Frame(status=daemon.status(), history=daemon.history(), url=daemon.url, is_on_screen=True)
    answered_s = history_s = time.monotonic()
    due_s = answered_s + interval_s
    with suppress(KeyboardInterrupt), Terminal() as terminal:
        terminal.draw(seen)
        while not terminal.wait(min(_REDRAW_S, max(0.0, due_s - time.monotonic()))):
            if (now_s := time.monotonic()) >= due_s:
                try:
                    seen, answered_s = replace(seen, status=daemon.status(), why_silent=""), now_s
                    if now_s - history_s >= _HISTORY_EVERY_S:
                        seen, history_s = replace(seen, history=daemon.history()), now_s
                except ArpdError as error:
                    seen, history_s = replace(seen, why_silent=str(error)), -math.inf
                due_s = time.monotonic() + interval_s
            terminal.draw(replace(seen, silent_s=time.monotonic() - answered_s))


class Terminal:
    """The process's terminal as a context manager that takes it over and restores it.

    SIGINT and SIGTERM raise KeyboardInterrupt in the block.
    """

    def __init__(self) -> None:
        sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]
        # A terminal, whatever the environment says: who opens this has looked.
        self._console = Console(highlight=False, force_terminal=True)
        self._live = Live(
            console=self._console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )
        self._keyboard = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            for number, handler in (
                (signal.SIGINT, signal.default_int_handler),
                (signal.SIGTERM, signal.default_int_handler),
                (signal.SIGTSTP, self._suspend),
            ):
                stack.callback(signal.signal, number, signal.signal(number, handler))
            self._take()
            stack.callback(self._give_back)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def wait(self, timeout_s: float) -> bool:
        """Wait; return whether the user wants to end."""
        watched = [self._keyboard] if self._keyboard >= 0 else []
        if not select.select(watched, [], [], timeout_s)[0]:
            return False
        keys = os.read(self._keyboard, 64)
        if not keys:
            self._keyboard = -1  # the keyboard is gone; signals still end this
        return any(key in _QUIT_KEYS for key in keys)

    def draw(self, frame: RenderableType) -> None:
        """Write a frame over the one before."""
        columns, lines = os.get_terminal_size(sys.stdout.fileno())
        self._console.size = columns or 80, lines or 24  # a serial line has no size
        self._live.update(frame, refresh=True)

    def _take(self) -> None:
        self._modes: list[Any] | None = None
        if self._keyboard >= 0:
            self._modes = termios.tcgetattr(self._keyboard)
            tty.setcbreak(self._keyboard, termios.TCSANOW)
        self._live.start()

    def _give_back(self) -> None:
        self._live.stop()
        if self._modes is not None:
            termios.tcsetattr(self._keyboard, termios.TCSANOW, self._modes)

    def _suspend(self, *_signal: object) -> None:
        """Restore the terminal and stop, as the shell asks; take the terminal again when the shell continues us."""
        self._give_back()
        ours = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, ours)
        self._take()


TOP = Command(_TEXT, _add_options, _top)
