"""`arpd doctor`: finds what about this computer harms a robot on Wi-Fi, and prints the fix."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arpd.cli.columns import WITHOUT_END, wrapped
from arpd.cli.options import DEFAULT_URL, add_address, within
from arpd.cli.progress import progress
from arpd.report.health import Health
from arpd.report.wording import count

if TYPE_CHECKING:
    from arpd.cli.checkup import Checkup

_LISTEN_S = 6.0  # a participant announces itself every three seconds
_MOST_LISTEN_S = 600.0
_MOST_LINES = 6


def add_doctor(commands: argparse._SubParsersAction[argparse.ArgumentParser], *, default_config: Path) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "doctor",
        help="find what about this computer harms a robot on Wi-Fi",
        description="""\
Look for what harms a robot on Wi-Fi, on either end of the link, and print the fix for each: clocks that differ between
the ends, Wi-Fi power save, a weak signal, no regulatory domain, small packets, datagrams that the kernel lost for want
of memory, discovery of other nodes on the link, nodes whose transports do not meet arpd's, AdaptivePublishers without
arpd's Fast DDS profile, versions of ROS, numpy and arpd that do not fit, units that do not run, faults of the
configuration.

It changes nothing, and needs no root. The clock, the profile and the daemon's version come from the daemon: on the
base computer, name the robot with --url (http.host in its configuration opens the port).""",
        epilog="""\
examples:
  arpd doctor                                on the robot
  arpd doctor --url http://robot.local:9464  on the base computer
  arpd doctor --far                          on the base computer, when the robot's port is closed
  arpd doctor --verbose                      what is fine, too
  arpd doctor --json | jq '.checks[] | select(.health == "wrong")'

exit codes: 0 nothing to do (a check may not have been possible), 1 something to do, 2 wrong usage""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument(
        "--config", type=Path, default=default_config, metavar="FILE", help="YAML configuration (default %(default)s)"
    )
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
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(handler=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    from arpd.cli.checkup import Asked, Senses, check_up
    from arpd.cli.client import address

    asked = Asked(
        daemon=address(options),
        has_own_url=options.url != DEFAULT_URL,
        config_path=options.config,
        interface=options.interface,
        is_far=options.far,
        listen_s=options.listen,
    )
    with progress(f"Looking, and listening to discovery for {options.listen:g} s"):
        found = check_up(asked, Senses())
    if options.json:
        print(json.dumps(document(found), indent=2))
    else:
        # A pipe has no width, unless COLUMNS gives it one.
        width = shutil.get_terminal_size((WITHOUT_END, WITHOUT_END)).columns
        sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr] # a terminal may lack a character
        print("\n".join(lines(found, width=width, is_verbose=options.verbose)))
    return 1 if any(each.health is Health.WRONG for each in found.findings.values()) else 0


def document(found: Checkup) -> dict[str, Any]:
    """Return a checkup as a JSON document."""
    return {
        "ok": not any(each.health is Health.WRONG for each in found.findings.values()),
        "end": "base" if found.is_far else "robot",
        "interface": found.interface or None,
        "checks": [{"check": about, **asdict(each)} for about, each in found.findings.items()],
    }


def lines(found: Checkup, *, width: int = WITHOUT_END, is_verbose: bool = False) -> list[str]:
    """Lay a checkup out for a terminal: what is wrong, each with its remedies, what is not known, and a count.

    Parameters
    ----------
    width : no sentence is wider; a remedy stays in one line, so that it can be copied (columns)
    is_verbose : whether what is fine is shown, too
    """
    wrong, unsure, fine = (
        {about: each for about, each in found.findings.items() if each.health is health}
        for health in (Health.WRONG, Health.UNKNOWN, Health.FINE)
    )
    shown: list[str] = []
    for about, each in wrong.items():
        shown += _sentence(f"wrong: {about}: {each.text}", width)
        shown += [f"    {remedy}" for remedy in each.remedies]
    for why in dict.fromkeys(each.text for each in unsure.values()):
        alike = ", ".join(about for about, each in unsure.items() if each.text == why)
        shown += _sentence(f"not known: {alike}: {why}", width)
    if is_verbose:
        for about, each in fine.items():
            shown += _sentence(f"fine: {about}: {each.text}", width)
    parts = [count(len(wrong), "thing") + " to do"] if wrong else []
    parts += [f"{count(len(fine), 'check')} fine"]
    parts += [f"{len(unsure)} not known"] if unsure else []
    return [*shown, ", ".join(parts)]


def _sentence(text: str, width: int) -> list[str]:
    return wrapped(text, width, indent=2, most=_MOST_LINES)
