"""`arpd top`: what the daemon sees and does, live in a terminal."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from arpd.cli.client import add_address, address
from arpd.cli.no_daemon import tell_no_daemon
from arpd.cli.status import show_status
from arpd.model.errors import ArpdError, DaemonUnreachableError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from arpd.cli.client import DaemonAddress
    from arpd.cli.terminal import Terminal

_LEAST_INTERVAL_S, _MOST_INTERVAL_S = 0.2, 3600.0
_HISTORY_EVERY_S = 10.0  # a sparkline shows ten minutes in fewer than 60 columns
_PATIENCE_S = 3.0


def add_top(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "top",
        help="watch what the daemon sees and does, live",
        description="""\
Show live what `arpd status` prints once. Topics that do not fit the terminal are counted.
q or Ctrl-C ends it. It waits for a daemon that goes away.""",
        epilog="""\
examples:
  arpd top
  arpd top --url http://robot.local:9464 --interval 5
  ARPD_PASSWORD=… arpd top --url https://robot.local:9464 --cacert ca.crt --user robot

exit codes: 0 ended by you, 2 wrong usage, 69 no daemon answers at the start; with --once those of arpd status""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument("--interval", type=float, default=1.0, metavar="S", help="seconds between updates (default 1)")
    parser.add_argument("--once", action="store_true", help="do as arpd status does")
    parser.set_defaults(handler=_top, json=False)


def _top(options: argparse.Namespace) -> int:
    if not _LEAST_INTERVAL_S <= options.interval <= _MOST_INTERVAL_S:
        raise UsageError(
            f"--interval {options.interval:g} is out of range; write {_LEAST_INTERVAL_S:g} to {_MOST_INTERVAL_S:g}"
        )
    if options.once:
        return show_status(options)
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") in {"dumb", "unknown"}:
        raise UsageError("arpd top needs a terminal; arpd status prints the same once")
    try:
        _watch(address(options), interval_s=options.interval)
    except DaemonUnreachableError as error:
        tell_no_daemon(error, options.url)
        return error.exit_code
    return 0


def _watch(daemon: DaemonAddress, *, interval_s: float) -> None:
    """Show a daemon on the terminal until the user ends it.

    Parameters
    ----------
    interval_s : pause between two questions (s)

    Raises
    ------
    DaemonUnreachableError
        If it does not answer at the start; later this waits for it.
    """
    from arpd.cli.terminal import Terminal

    asking = _Asking(daemon, interval_s=interval_s)
    with Terminal() as terminal, asking.going_on(terminal.wake):
        while True:
            is_silent = _draw(terminal, asking.seen, daemon.url, patience_s=3 * interval_s + _PATIENCE_S)
            # The age on the screen counts up, with or without news.
            if terminal.wait(1.0 if is_silent else 2.0):
                return


@dataclass(frozen=True, kw_only=True, slots=True)
class _Seen:
    """The daemon's last answers.

    Parameters
    ----------
    answered_s : monotonic clock when it answered last (s)
    why_silent : why the last try failed, empty when it did not
    """

    status: dict[str, Any]
    history: dict[str, Any] | None
    answered_s: float
    why_silent: str = ""


class _Asking:
    """Asks a daemon again and again in a thread, so that one that hangs does not hold up the screen.

    The constructor waits for the first answer: without one there is nothing to show.

    Parameters
    ----------
    daemon : the daemon to ask
    interval_s : pause between two questions (s)
    """

    def __init__(self, daemon: DaemonAddress, *, interval_s: float) -> None:
        self._daemon = daemon
        self._interval_s = interval_s
        self._ended = threading.Event()
        self._history_s = time.monotonic()
        self.seen = _Seen(status=daemon.status(), history=daemon.history(), answered_s=time.monotonic())

    @contextmanager
    def going_on(self, on_seen: Callable[[], None]) -> Iterator[None]:
        """Go on asking until the end of the block; call ``on_seen`` in that thread after each answer."""
        # A daemon thread: the end of the block does not wait for a question under way.
        threading.Thread(target=self._ask, args=(on_seen,), name="asking", daemon=True).start()
        try:
            yield
        finally:
            self._ended.set()

    def _ask(self, on_seen: Callable[[], None]) -> None:
        while not self._ended.wait(self._interval_s):
            self.seen = self._next(self.seen)
            on_seen()

    def _next(self, seen: _Seen) -> _Seen:
        try:
            status, history = self._daemon.status(), seen.history
            now_s = time.monotonic()
            if seen.why_silent or now_s - self._history_s >= _HISTORY_EVERY_S:
                history, self._history_s = self._daemon.history(), now_s
        except ArpdError as error:
            return replace(seen, why_silent=str(error))
        return _Seen(status=status, history=history, answered_s=now_s)


def _draw(terminal: Terminal, seen: _Seen, url: str, *, patience_s: float) -> bool:
    """Draw a frame; return whether the daemon is silent."""
    from arpd.cli.frame import Frame

    silent_s = time.monotonic() - seen.answered_s
    why = seen.why_silent or ("it takes long to answer" if silent_s > patience_s else "")
    said = Frame(
        status=seen.status, history=seen.history, url=url, silent_s=silent_s, why_silent=why, is_on_screen=True
    )
    terminal.draw(said)
    return bool(why)
