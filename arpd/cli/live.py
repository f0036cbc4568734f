"""The live part of `arpd top`: asking in a thread, drawing in another, until the user has seen enough."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from arpd.cli.frame import View, frame
from arpd.cli.terminal import Terminal
from arpd.model.errors import ArpdError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from arpd.cli.client import DaemonAddress

_HISTORY_EVERY_S = 10.0  # a sparkline shows ten minutes, and has fewer columns
_PATIENCE_S = 3.0


def watch(daemon: DaemonAddress, *, interval_s: float) -> None:
    """Show a daemon on the terminal until the user ends it.

    Parameters
    ----------
    interval_s : pause between two questions (s)

    Raises
    ------
    DaemonUnreachableError
        If it does not answer at the start; later it is waited for.
    """
    asking = Asking(daemon, interval_s=interval_s)
    with Terminal() as terminal, asking.going_on(terminal.wake):
        while True:
            is_silent = _draw(terminal, asking.seen, daemon.url, patience_s=3 * interval_s + _PATIENCE_S)
            # The age of what is shown counts up, whether or not there is news.
            if terminal.wait(1.0 if is_silent else 2.0):
                return


@dataclass(frozen=True, kw_only=True, slots=True)
class Seen:
    """What the daemon told last, and how the last try to ask it went.

    Parameters
    ----------
    answered_s : monotonic clock when it answered last (s)
    why_silent : why the last try failed, empty when it did not
    """

    status: dict[str, Any]
    history: dict[str, Any] | None
    answered_s: float
    why_silent: str = ""


class Asking:
    """Asks a daemon again and again, in a thread of its own, so that one that hangs does not hold up the screen.

    The first answer is waited for here: without one there is nothing to show.

    Parameters
    ----------
    daemon : whom to ask
    interval_s : pause between two questions (s)
    """

    def __init__(self, daemon: DaemonAddress, *, interval_s: float) -> None:
        self._daemon = daemon
        self._interval_s = interval_s
        self._ended = threading.Event()
        self._history_s = time.monotonic()
        self.seen = Seen(status=daemon.status(), history=daemon.history(), answered_s=time.monotonic())

    @contextmanager
    def going_on(self, on_seen: Callable[[], None]) -> Iterator[None]:
        """Go on asking until the end of the block; each time, ``on_seen`` is called in that thread."""
        # A question that is under way at the end need not be waited for.
        threading.Thread(target=self._ask, args=(on_seen,), name="asking", daemon=True).start()
        try:
            yield
        finally:
            self._ended.set()

    def _ask(self, on_seen: Callable[[], None]) -> None:
        while not self._ended.wait(self._interval_s):
            self.seen = self._next(self.seen)
            on_seen()

    def _next(self, seen: Seen) -> Seen:
        try:
            status, history = self._daemon.status(), seen.history
            now_s = time.monotonic()
            if seen.why_silent or now_s - self._history_s >= _HISTORY_EVERY_S:
                history, self._history_s = self._daemon.history(), now_s
        except ArpdError as error:
            return Seen(status=seen.status, history=seen.history, answered_s=seen.answered_s, why_silent=str(error))
        return Seen(status=status, history=history, answered_s=now_s)


def _draw(terminal: Terminal, seen: Seen, url: str, *, patience_s: float) -> bool:
    """Draw a frame; whether the daemon is silent."""
    width, height = terminal.size()
    silent_s = time.monotonic() - seen.answered_s
    why = seen.why_silent or ("it takes long to answer" if silent_s > patience_s else "")
    view = View(width=width, height=height, url=url, silent_s=silent_s, why_silent=why, is_ascii=terminal.is_ascii)
    terminal.draw(frame(seen.status, seen.history, view))
    return bool(why)
