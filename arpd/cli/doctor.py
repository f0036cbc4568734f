"""`arpd doctor`: finds what about this computer harms a robot on Wi-Fi, and prints the fix."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from arpd.cli import checks_host, checks_link
from arpd.cli.checkup import Here, unknown
from arpd.cli.options import Command, add_address, add_config, add_json, within
from arpd.cli.output import width_of_output, wrapped
from arpd.cli.progress import progress
from arpd.model.errors import NotKnownError
from arpd.report.wording import count

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from arpd.cli.checkup import Finding

_LISTEN_S = 6.0  # a participant announces itself every three seconds
_MOST_LISTEN_S = 600.0
_MOST_LINES = 6
_TEXT = """\
Look for what harms a robot on Wi-Fi, on either end of the link, and print the fix for each: clocks that differ between
the ends, Wi-Fi power save, a weak signal, no regulatory domain, small packets, datagrams that the kernel lost for want
of memory, discovery of other nodes on the link, nodes whose transports do not meet arpd's, AdaptivePublishers without
arpd's Fast DDS profile, versions of ROS, numpy and arpd that do not fit, units that do not run, faults of the
configuration.

It changes nothing, and needs no root. The clock, the profile and the daemon's version come from the daemon: on the
base computer, name the robot with --url (http.host in its configuration opens the port).

examples:
  arpd doctor                                on the robot
  arpd doctor --url http://robot.local:9464  on the base computer
  arpd doctor --far                          on the base computer, when the robot's port is closed
  arpd doctor --verbose                      what is fine, too
  arpd doctor --json | jq '.checks[] | select(.health == "wrong")'

exit codes: 0 nothing to do (a check may not have been possible), 1 something to do, 2 wrong usage"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_address(parser)
    add_config(parser)
    parser.add_argument(
        "--far", action="store_true", help="this computer is the base computer; --url of a robot implies it"
    )
    parser.add_argument("--interface", metavar="NAME", default="", help="interface of the link here (default: find it)")
    parser.add_argument(
        "--listen",
        type=within(0.0, _MOST_LISTEN_S, parse=float),
        default=_LISTEN_S,
        metavar="SECONDS",
        help="time to listen to discovery, 0 = do not (default %(default)g)",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="show what is fine, too")
    add_json(parser)


def _doctor(options: argparse.Namespace) -> int:
    with progress(f"Looking, and listening to discovery for {options.listen:g} s"):
        here = Here(options)
        findings = check_up(here)
    is_well = not any(each.health == "wrong" for each in findings.values())
    if options.json:
        checks = [{"check": about, **each._asdict()} for about, each in findings.items()]
        end, interface = "base" if here.is_far else "robot", here.found_interface or None
        print(json.dumps({"ok": is_well, "end": end, "interface": interface, "checks": checks}, indent=2))
    else:
        print("\n".join(lines(findings, width=width_of_output(), is_verbose=options.verbose)))
    return 0 if is_well else 1


def check_up(here: Here) -> dict[str, Finding]:
    """Return what every check finds, by its name; a check that does not concern this computer finds nothing."""
    findings = {}
    for check in (*checks_link.CHECKS, *checks_host.CHECKS):
        try:
            found = check(here)
        except NotKnownError as error:
            found = unknown(str(error))
        if found is not None:
            findings[check.__name__.replace("_", " ")] = found
    return findings


def lines(findings: Mapping[str, Finding], *, width: int, is_verbose: bool = False) -> list[str]:
    """Lay findings out for a terminal: what is wrong, each with its remedies, what is not known, and a count.

    Parameters
    ----------
    width : no sentence is wider; a remedy stays in one line, so that it can be copied (columns)
    is_verbose : whether what is fine is shown, too
    """
    wrong, unsure, fine = (
        {about: each for about, each in findings.items() if each.health == health}
        for health in ("wrong", "unknown", "fine")
    )
    alike: dict[str, list[str]] = {}
    for about, each in unsure.items():
        alike.setdefault(each.text, []).append(about)
    sentences = [(f"wrong: {about}: {each.text}", each.remedies) for about, each in wrong.items()]
    sentences += [(f"not known: {', '.join(abouts)}: {why}", ()) for why, abouts in alike.items()]
    sentences += [(f"fine: {about}: {each.text}", ()) for about, each in fine.items() if is_verbose]
    shown: list[str] = []
    for sentence, remedies in sentences:
        shown += [*wrapped(sentence, width, indent=2, most=_MOST_LINES), *(f"    {remedy}" for remedy in remedies)]
    parts = [count(len(wrong), "thing") + " to do"] if wrong else []
    parts += [f"{count(len(fine), 'check')} fine", *([f"{len(unsure)} not known"] if unsure else [])]
    return [*shown, ", ".join(parts)]


DOCTOR = Command(_TEXT, _add_options, _doctor)
