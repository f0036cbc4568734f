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
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live

from arpd.cli.client import Daemon
from arpd.cli.frame import Frame
from arpd.cli.options import Command, add_address
from arpd.model.errors import ArpdError, UsageError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

_QUIT_KEYS = b"qQ\x03"
_INTERVAL_S = 1.0
_HISTORY_EVERY_S = 10.0  # a sparkline shows ten minutes in fewer than 60 columns
_TEXT = """\
Show live what `arpd status` prints once, as far as it fits the terminal. q or Ctrl-C ends it.
It waits for a daemon that goes away.

examples:
  arpd top
  arpd top --url http://robot.local:9464
  ARPD_PASSWORD=… arpd top --url https://robot.local:9464 --cacert ca.crt --user robot

exit codes: 0 ended by you, 1 the daemon is of another version, 2 wrong usage, 3 no daemon answers at the start"""


def _top(options: argparse.Namespace) -> int:
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") in {"dumb", "unknown"}:
        raise UsageError("arpd top needs a terminal; arpd status prints the same once")
    with Daemon(options) as daemon:
        seen = Frame(status=daemon.status(), history=daemon.history(), url=daemon.url)
        answered_s = history_s = time.monotonic()
        # A terminal, whatever the environment says: this has looked.
        console = Console(highlight=False, force_terminal=True)
        live = Live(
            seen, console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )
        with _keyboard() as is_ended, live:
            while not is_ended(_INTERVAL_S):
                try:
                    seen = replace(seen, status=daemon.status(), why_silent="")
                    answered_s = time.monotonic()
                    if answered_s - history_s >= _HISTORY_EVERY_S:
                        seen, history_s = replace(seen, history=daemon.history()), answered_s
                except ArpdError as error:
                    seen, history_s = replace(seen, why_silent=str(error)), -math.inf
                live.update(replace(seen, silent_s=time.monotonic() - answered_s), refresh=True)
    return 0


@contextmanager
def _keyboard() -> Iterator[Callable[[float], bool]]:
    """Take the keyboard, where there is one; Ctrl-C and SIGTERM are keys, too, and Ctrl-Z would leave the screen torn.

    An exception would come anywhere: within a frame it leaves the screen as it is.

    Yields
    ------
    A function that waits for so long (s), and returns whether the user wants to end.
    """
    signals, told = os.pipe()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: os.write(told, b"q"))
    signal.signal(signal.SIGTSTP, signal.SIG_IGN)
    watched = [sys.stdin.fileno()] if sys.stdin is not None and sys.stdin.isatty() else []
    before = [(keyboard, termios.tcgetattr(keyboard)) for keyboard in watched]

    def is_ended(timeout_s: float) -> bool:
        readable = select.select([signals, *watched], [], [], timeout_s)[0]
        return any(not (keys := os.read(each, 64)) or set(keys) & set(_QUIT_KEYS) for each in readable)

    try:
        for keyboard in watched:
            tty.setcbreak(keyboard, termios.TCSANOW)
        yield is_ended
    finally:
        for keyboard, modes in before:
            termios.tcsetattr(keyboard, termios.TCSANOW, modes)


TOP = Command(_TEXT, add_address, _top)
