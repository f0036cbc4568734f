"""A terminal's whole screen: taken over, drawn on, resized, suspended and restored."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import tty
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.live import Live

if TYPE_CHECKING:
    from rich.console import RenderableType

_QUIT_KEYS = b"qQ\x03"


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
