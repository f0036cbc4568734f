"""`arpd status` and `arpd top`: one frame of what the daemon sees and does, once or live, and an exit code."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from contextlib import suppress
from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING

from arpd.cli.no_daemon import tell_no_daemon
from arpd.cli.options import add_address, within
from arpd.model.errors import ArpdError, DaemonUnreachableError, UsageError
from arpd.report.conditions import Condition

if TYPE_CHECKING:
    from arpd.cli.client import Daemon

_LEAST_INTERVAL_S, _MOST_INTERVAL_S = 0.2, 3600.0
_HISTORY_EVERY_S = 10.0  # a sparkline shows ten minutes in fewer than 60 columns
_REDRAW_S = 1.0  # the age of a silent daemon's answer counts up
# From the table that decides it, so that none is missing.
_WRONG = ", ".join(dict.fromkeys(["Not ready", *(each.headline for each in Condition if each.is_wrong)]))
_EXIT_CODES = f"""\
exit codes:
  0   the daemon manages its topics, and all is well; a slow link that arpd copes with is well
  1   the daemon answers, and a line says what is wrong:
{fill(_WRONG, 112, initial_indent=" " * 6, subsequent_indent=" " * 6)}
  2   wrong usage
  3   no daemon answers there, or none that lets you in"""


def add_status(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "status",
        help="show what the daemon sees and does",
        description="""\
Ask a running daemon for its last tick: whether all is well; capacity, queue and the allowed part of the traffic above
the minimum rates, with their last ten minutes; the budget of the topics; the plan and its reason; the topics (first
refusals, then those that give up most) with the rate that each publisher is allowed, the DEPTH and DEADLINE that it
announces (`now→planned` where the two differ) and its withheld messages; the last lines of the decision log. `arpd top`
shows the same live. A pipe gets everything as wide as it is, or as COLUMNS says; NO_COLOR takes the colours away.""",
        epilog=f"""\
examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {{topic, planned, confirmed}}'
  arpd status >/dev/null || echo "look at the robot"

{_EXIT_CODES}""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument("--json", action="store_true", help="print the daemon's JSON")
    parser.set_defaults(handler=_status)


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

exit codes: 0 ended by you, 2 wrong usage, 3 no daemon answers at the start""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    interval = within(_LEAST_INTERVAL_S, _MOST_INTERVAL_S, parse=float)
    parser.add_argument(
        "--interval", type=interval, default=1.0, metavar="S", help="seconds between updates (default 1)"
    )
    parser.set_defaults(handler=_top)


def _top(options: argparse.Namespace) -> int:
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") in {"dumb", "unknown"}:
        raise UsageError("arpd top needs a terminal; arpd status prints the same once")
    from arpd.cli.client import connect

    try:
        with connect(options) as daemon:
            _watch(daemon, interval_s=options.interval)
    except DaemonUnreachableError as error:
        tell_no_daemon(error, options.url)
        return error.exit_code
    return 0


def _status(options: argparse.Namespace) -> int:
    """Print a daemon's status; return the exit code."""
    from arpd.cli.client import connect, read_status
    from arpd.cli.frame import Frame, findings
    from arpd.cli.output import show

    try:
        with connect(options) as daemon:
            document = daemon.document()
            history = None if options.json else daemon.history()
    except DaemonUnreachableError as error:
        tell_no_daemon(error, options.url)
        return error.exit_code
    if options.json:
        print(json.dumps(document, indent=2))
    status = read_status(document, url=options.url)
    wrong = [finding.text for finding in findings(status) if finding.wrong]
    if status is None or options.json:
        for fault in wrong:
            print(f"arpd: {fault}", file=sys.stderr)
    else:
        show(Frame(status=status, history=history, url=options.url))
    return 1 if wrong else 0


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
    from arpd.cli.frame import Frame
    from arpd.cli.terminal import Terminal

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
