"""`arpd doctor`: names what about this computer harms a robot on Wi-Fi, and the line that mends it."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from typing import TYPE_CHECKING, Any

from arpd.cli.client import add_address, address
from arpd.cli.columns import WITHOUT_END, wrapped
from arpd.cli.progress import progress
from arpd.report.health import Health
from arpd.report.wording import count

if TYPE_CHECKING:
    from pathlib import Path

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
Look for what harms a robot on Wi-Fi, on either end of the link, and name the line that mends each: clocks that differ
between the ends, Wi-Fi power save, a weak signal, no regulatory domain, small packets, datagrams that the kernel lost
for want of memory, discovery of other nodes on the link, nodes whose transports do not meet arpd's, AdaptivePublishers
without arpd's Fast DDS profile, versions of ROS, numpy and arpd that do not fit, units that do not run, faults of the
configuration.

It changes nothing, and needs no root. The clock, the profile and the daemon's version come from the daemon: on the
CEDDP, name the robot with --url (http.host in its configuration opens the port).""",
        epilog="""\
examples:
  arpd doctor                                on the robot
  arpd doctor --url http://robot.local:9464  on the CEDDP
  arpd doctor --far                          on the CEDDP, when the robot's port is closed
  arpd doctor --verbose                      what is fine, too
  arpd doctor --json | jq '.checks[] | select(.health == "wrong")'

exit codes: 0 nothing to do (a check may not have been possible), 1 something to do, 2 wrong usage""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_address(parser)
    parser.add_argument(
        "--config", type=_path, default=default_config, metavar="FILE", help="YAML configuration (default %(default)s)"
    )
    parser.add_argument("--far", action="store_true", help="this computer is the CEDDP; --url of a robot implies it")
    parser.add_argument("--interface", metavar="NAME", default="", help="interface of the link here (default: find it)")
    parser.add_argument(
        "--listen",
        type=_seconds,
        default=_LISTEN_S,
        metavar="SECONDS",
        help="time to listen to discovery, 0 = do not (default %(default)g)",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="show what is fine, too")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(handler=lambda options: _doctor(options, default_url=parser.get_default("url")))


def _path(word: str) -> Path:
    from pathlib import Path

    return Path(word)


def _seconds(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= _MOST_LISTEN_S:
        raise argparse.ArgumentTypeError(f"{word!r} is no time; write 0..{_MOST_LISTEN_S:g} seconds")
    return value


def _doctor(options: argparse.Namespace, *, default_url: str) -> int:
    from arpd.cli.checkup import Asked, Senses, check_up

    asked = Asked(
        daemon=address(options),
        has_own_url=options.url != default_url,
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
    return 1 if any(each.health is Health.WRONG for each in found.judgements) else 0


def document(found: Checkup) -> dict[str, Any]:
    """Return a checkup as a JSON document."""
    return {
        "ok": not any(each.health is Health.WRONG for each in found.judgements),
        "end": "ceddp" if found.is_far else "robot",
        "interface": found.interface or None,
        "checks": [
            {
                "check": each.about,
                "health": str(each.health),
                "text": each.text,
                "remedies": list(each.remedies),
            }
            for each in found.judgements
        ],
    }


def lines(found: Checkup, *, width: int = WITHOUT_END, is_verbose: bool = False) -> list[str]:
    """Lay a checkup out for a terminal: what is wrong, each with its remedies, what is not known, and a count.

    Parameters
    ----------
    width : no sentence is wider; a remedy stays in one line, so that it can be copied (columns)
    is_verbose : whether what is fine is shown, too
    """
    by_health = {health: [each for each in found.judgements if each.health is health] for health in Health}
    shown: list[str] = []
    for each in by_health[Health.WRONG]:
        shown += _sentence(f"wrong: {each.about}: {each.text}", width)
        shown += [f"    {remedy}" for remedy in each.remedies]
    reasons: dict[str, list[str]] = {}
    for each in by_health[Health.UNKNOWN]:
        reasons.setdefault(each.text, []).append(each.about)
    for why, about in reasons.items():
        shown += _sentence(f"not known: {', '.join(about)}: {why}", width)
    if is_verbose:
        for each in by_health[Health.FINE]:
            shown += _sentence(f"fine: {each.about}: {each.text}", width)
    wrong, fine, unsure = (len(by_health[health]) for health in (Health.WRONG, Health.FINE, Health.UNKNOWN))
    parts = [count(wrong, "thing") + " to do"] if wrong else []
    parts += [f"{count(fine, 'check')} fine"]
    parts += [f"{unsure} not known"] if unsure else []
    return [*shown, ", ".join(parts)]


def _sentence(text: str, width: int) -> list[str]:
    return wrapped(text, width, indent=2, most=_MOST_LINES)
