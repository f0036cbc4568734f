"""`arpd status`: a frame of what the daemon sees and does, and an exit code."""

from __future__ import annotations

import json
import sys
from textwrap import fill
from typing import TYPE_CHECKING

from arpd.cli.client import Daemon, read_status
from arpd.cli.frame import Frame, findings
from arpd.cli.options import Command, add_address, add_json
from arpd.cli.output import show
from arpd.report.conditions import Condition

if TYPE_CHECKING:
    import argparse

# From the table that decides it, so that none is missing.
_WRONG = ", ".join(dict.fromkeys(["Not ready", *(each.headline for each in Condition if each.is_wrong)]))
_TEXT = f"""\
Ask a running daemon for its last tick: whether all is well; capacity, queue and the allowed part of the traffic above
the minimum rates, with their last ten minutes; the budget of the topics; the plan and its reason; the topics (first
refusals, then those that give up most) with the rate that each publisher is allowed, the one that it sends and that of
its source, the DEPTH and DEADLINE that it announces (`now→planned` where the two differ), the share of messages that it
has withheld since it began, how many deadlines it has missed, and what bounds it or why it refuses; the last lines of
the decision log. With two ends of a relay topics send more than they are allowed while the link takes it. `arpd top`
shows the same live. A pipe gets everything as wide as it is, or as COLUMNS says; NO_COLOR takes the colours away.

examples:
  arpd status
  arpd status --url http://robot.local:9464
  ARPD_PASSWORD=… arpd status --url https://robot.local:9464 --cacert ca.crt --user robot
  arpd status --json | jq '.topics[] | {{topic, planned, confirmed}}'
  arpd status >/dev/null || echo "look at the robot"

exit codes:
  0   the daemon manages its topics, and all is well; a slow link that arpd copes with is well
  1   the daemon answers, and a line says what is wrong:
{fill(_WRONG, 112, initial_indent=" " * 6, subsequent_indent=" " * 6)}
  2   wrong usage
  3   no daemon answers there, or none that lets you in"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_address(parser)
    add_json(parser, "print the daemon's JSON")


def _status(options: argparse.Namespace) -> int:
    with Daemon(options) as daemon:
        document = daemon.document()
        history = None if options.json else daemon.history()
    if options.json:
        print(json.dumps(document, indent=2))
    status = read_status(document, source=options.url.url)
    wrong = [finding.text for finding in findings(status) if finding.wrong]
    if status is None or options.json:
        for fault in wrong:
            print(f"arpd: {fault}", file=sys.stderr)
    else:
        show(Frame(status=status, history=history, url=options.url.url))
    return 1 if wrong else 0


STATUS = Command(_TEXT, _add_options, _status)
