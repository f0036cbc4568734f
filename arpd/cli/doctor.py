"""`arpd doctor`: finds what about this computer harms a robot on Wi-Fi, and prints the fix."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from arpd.cli.checks import CHECKS, Finding
from arpd.cli.here import Here
from arpd.cli.options import Command, add_address, add_config, add_json, within
from arpd.cli.output import progress, width_of_output, wrapped
from arpd.model.errors import NotKnownError
from arpd.report.wording import count

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

_LISTEN_S = 6.0  # a participant announces itself every three seconds
_MOST_LISTEN_S = 600.0
_MOST_LINES = 6
_TEXT = """\
Look for what harms a robot on Wi-Fi, on either end of the link, and print the fix for each: what the daemon finds wrong
(as in `arpd status`), clocks that differ between the ends, Wi-Fi power save, a weak signal, no regulatory domain, a
link without an address, small packets, datagrams that the kernel lost for want of memory, discovery of other nodes on
the link, computers to which every sample crosses twice, nodes whose transports do not meet arpd's, AdaptivePublishers
without arpd's Fast DDS profile, another middleware than Fast DDS, versions of arpd that do not fit, units that do not
run, robots that this base computer does not hear, faults of the configuration.

It changes nothing, and needs no root. Its findings, the clock, the profile and its version come from the daemon: on the
base computer, name the robot with --url (http.host in its configuration opens the port).

examples:
  arpd doctor                                on the robot
  arpd doctor --url http://robot.local:9464  on the base computer
  arpd doctor --far                          on the base computer, when the robot's port is closed
  arpd doctor --json                         what is fine, too

exit codes: 0 nothing to do (a check may not have been possible), 1 something to do, 2 wrong usage, 78 no such FILE"""


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
        print("\n".join(lines(findings, width=width_of_output())))
    return 0 if is_well else 1


def check_up(here: Here) -> dict[str, Finding]:
    """Return what every check finds, by its name."""
    findings = {}
    for check in CHECKS:
        try:
            found = check(here)
        except NotKnownError as error:
            found = Finding("unknown", str(error))
        findings[check.__name__.replace("_", " ")] = found
    return findings


def lines(findings: Mapping[str, Finding], *, width: int) -> list[str]:
    """Lay findings out for a terminal: what is wrong, each with its remedies, what is not known, and a count.

    No sentence is wider; a remedy stays in one line, so that it can be copied.
    """
    alike: dict[tuple[str, Finding], list[str]] = {}
    for title, health in {"wrong": "wrong", "not known": "unknown"}.items():
        for about, each in findings.items():
            if each.health == health:
                alike.setdefault((title, each), []).append(about)
    shown = []
    for (title, each), abouts in alike.items():
        shown += wrapped(f"{title}: {', '.join(abouts)}: {each.text}", width, indent=2, most=_MOST_LINES)
        shown += [f"    {remedy}" for remedy in each.remedies]
    wrong, unknown, fine = (
        sum(each.health == health for each in findings.values()) for health in ("wrong", "unknown", "fine")
    )
    parts = [f"{count(wrong, 'thing')} to do"] if wrong else []
    return [*shown, ", ".join([*parts, f"{count(fine, 'check')} fine", *([f"{unknown} not known"] if unknown else [])])]


DOCTOR = Command(_TEXT, _add_options, _doctor)
