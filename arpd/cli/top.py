"""`arpd top`: what the daemon sees and does, live in a terminal."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from arpd.cli.client import add_address, address
from arpd.model.errors import UsageError

if TYPE_CHECKING:
    from arpd.cli.client import DaemonAddress

_LEAST_INTERVAL_S, _MOST_INTERVAL_S = 0.2, 3600.0
_PIPE_COLUMNS, _PIPE_LINES = 120, 1000


def add_top(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "top",
        help="watch what the daemon sees and does, live",
        description="""\
Show a running daemon live: whether the link is the limit and whether arpd copes, capacity, queue and gate with their
last ten minutes, the plan and why it is the one, the topics (first those that are refused something, then those that
give up most), and the last lines of the decision log. What the terminal has no room for is summed up.
q or Ctrl-C ends it. A daemon that goes away is waited for.""",
        epilog="""\
examples:
  arpd top
  arpd top --url http://robot.local:9464 --interval 5
  ARPD_PASSWORD=… arpd top --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd top --once                            one frame, also into a pipe, as wide as COLUMNS says

exit codes: 0 ended by you, 2 wrong usage, 69 no daemon answers at the start""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument("--interval", type=float, default=1.0, metavar="S", help="seconds between updates (default 1)")
    parser.add_argument("--once", action="store_true", help="print one frame and exit")
    parser.set_defaults(handler=_top)


def _top(options: argparse.Namespace) -> int:
    if not _LEAST_INTERVAL_S <= options.interval <= _MOST_INTERVAL_S:
        raise UsageError(
            f"--interval {options.interval:g} is out of range; write {_LEAST_INTERVAL_S:g} to {_MOST_INTERVAL_S:g}"
        )
    daemon = address(options)
    if options.once:
        _print_once(daemon)
        return 0
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") in {"dumb", "unknown"}:
        raise UsageError("arpd top needs a terminal; --once prints one frame anywhere")

    from arpd.cli.live import watch

    watch(daemon, interval_s=options.interval)
    return 0


def _print_once(daemon: DaemonAddress) -> None:
    import shutil

    from rich.console import Console

    from arpd.cli.frame import View, frame

    status, history = daemon.status(), daemon.history()
    if sys.stdout.isatty():
        width, lines = shutil.get_terminal_size()
        height = lines - 1  # the shell's prompt wants one, too
    else:
        width, height = shutil.get_terminal_size((_PIPE_COLUMNS, _PIPE_LINES))
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]
    console = Console(width=width, height=height, highlight=False)
    view = View(width=width, height=height, url=daemon.url, is_ascii=not console.encoding.startswith("utf"))
    console.print(frame(status, history, view))
