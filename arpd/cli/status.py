"""`arpd status`: one frame of what the daemon sees and does, and an exit code for scripts."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from arpd.cli.client import add_address, address
from arpd.cli.no_daemon import tell_no_daemon
from arpd.cli.status_facts import findings
from arpd.model.errors import ArpdError, DaemonUnreachableError
from arpd.report.status import API_VERSION

if TYPE_CHECKING:
    from arpd.cli.client import DaemonAddress

_NOT_RUNNING = 3  # as systemctl status and every init script since LSB say it


def add_status(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "status",
        help="show what the daemon sees and does",
        description="""\
Ask a running daemon for its last tick: whether all is well; capacity, queue and the part of the traffic that is
admitted, with their last ten minutes; the budget of the topics; the plan and its reason; the topics (first refusals,
then those that give up most) with the rate that each publisher is allowed, the DEPTH and DEADLINE that it announces
(`now→planned` where the two differ) and its withheld messages; the last lines of the decision log. `arpd top` shows the
same live. A pipe gets everything as wide as it is, or as COLUMNS says; NO_COLOR takes the colours away.""",
        epilog="""\
examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {topic, planned, confirmed}'
  arpd status >/dev/null || echo "look at the robot"

exit codes:
  0   the daemon governs, and all is well; a slow link that arpd copes with is well
  1   the daemon answers, and a line says what is wrong: it is not ready, no tick finishes, it stands by for another
      daemon, the interface or the link carries nothing, it refused the last reload, not even the floors and reserves
      fit, or a plan is not confirmed after 15 s
  2   wrong usage
  3   no daemon answers there, or none that lets you in""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument("--json", action="store_true", help="print the daemon's JSON")
    parser.set_defaults(handler=show_status)


def show_status(options: argparse.Namespace) -> int:
    """Print a daemon's status; return the exit code."""
    daemon = address(options)
    try:
        status = daemon.status()
    except DaemonUnreachableError as error:
        tell_no_daemon(error, options.url)
        return _NOT_RUNNING
    wrong = [finding.text for finding in findings(status) if finding.is_wrong]
    if "link" in status and not options.json:
        if status["api_version"] != API_VERSION:
            raise ArpdError(f"the daemon at {options.url} speaks another version of arpd; use --json")
        _print_frame(daemon, status)
        return 1 if wrong else 0
    if options.json:
        print(json.dumps(status, indent=2))
    for fault in wrong:
        print(f"arpd: {fault}", file=sys.stderr)
    return 1 if wrong else 0


def _print_frame(daemon: DaemonAddress, status: dict[str, Any]) -> None:
    from arpd.cli.frame import Frame
    from arpd.cli.output import show

    try:
        history = daemon.history()
    except DaemonUnreachableError:
        history = None
    show(Frame(status=status, history=history, url=daemon.url))
