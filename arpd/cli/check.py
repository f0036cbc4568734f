"""`arpd check`: names the faults of a configuration, or says what it means."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.cli.options import DEFAULT_CONFIG, Command, add_json
from arpd.host.config.keys import changes, flatten
from arpd.host.config.load import load_settings, local_domain
from arpd.host.interface import list_interfaces, read_memory
from arpd.model.errors import ConfigError
from arpd.model.quantities import format_rate
from arpd.model.settings import Backend, Settings
from arpd.solve.topics import Traffic, rows_of_traffic
from arpd.web.web_config import load_protection

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from arpd.model.settings import RelaySettings

# Memory that a back end adds to `arpd run`, which has numpy anyway (x86-64, Python 3.11, 12 topics).
_EXTRA_BYTES = {Backend.CLOSED_FORM: 0, Backend.OSQP: 14 * 2**20, Backend.CVXPY: 82 * 2**20}
_WORTH_A_WARNING = 0.01  # of the host's memory: OSQP below 1.4 GiB, cvxpy below 8 GiB
_TEXT = """\
Check a configuration file exactly as the daemon does. Every fault is one line, FILE:LINE:COLUMN: KEY: what is wrong;
what would be right. A line with "warning:" is no fault: the key costs this host much memory, or the minimum rates do
not fit the link. Exits 0 without faults, 78 with.

examples:
  arpd check                                 checks /etc/arpd/arpd.yaml
  arpd check my.yaml && sudo systemctl reload arpd
  arpd check --far                           on the base computer, for `arpd relay --far` and `arpd peer`
  arpd check --no-interfaces robot.yaml      on another computer than the robot
  arpd check --json my.yaml | jq .settings   every key with the value in force"""


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", nargs="?", type=Path, default=DEFAULT_CONFIG, help="YAML file (default %(default)s)")
    parser.add_argument(
        "--far", action="store_true", help="check for the far end, on the base computer; link.interface is the robot's"
    )
    parser.add_argument(
        "--no-interfaces",
        action="store_true",
        help="do not compare with this computer: neither link.interface nor memory",
    )
    add_json(parser)


def _check(options: argparse.Namespace) -> int:
    interfaces = None if options.far or options.no_interfaces else list_interfaces
    try:
        settings = load_settings(options.file, interfaces=interfaces, local_domain=local_domain())
        if not options.far:
            load_protection(settings.http, directory=options.file.parent)
    except ConfigError as error:
        if not options.json:
            raise
        print(json.dumps({"ok": False, "file": str(options.file), "faults": error.faults}, indent=2))
        return error.exit_code
    host_bytes = 0 if options.far or options.no_interfaces else read_memory().total_bytes
    warned = [] if options.far else [f"{options.file}: {warning}" for warning in _warnings(settings, host_bytes)]
    if options.json:
        document = {"ok": True, "file": str(options.file), "warnings": warned, "settings": flatten(settings)}
        print(json.dumps(document, indent=2))
        return 0
    for warning in warned:
        print(warning, file=sys.stderr)
    print("\n".join(_summary(settings, is_far=options.far)))
    return 0


def _warnings(settings: Settings, host_bytes: int) -> Iterator[str]:
    """Yield what costs a host of so much memory (0 = unknown) more than it needs, or asks more than the link has."""
    backend = settings.program.backend
    extra_bytes = _EXTRA_BYTES[backend]
    if host_bytes and extra_bytes > _WORTH_A_WARNING * host_bytes:
        yield (
            f"program.backend: warning: {backend} takes {extra_bytes / 2**20:.0f} MiB, "
            f"{100 * extra_bytes / host_bytes:.1f} % of this host's memory; {Backend.CLOSED_FORM} takes none, "
            "and gives the same rates to a millionth"
        )
    known = [
        Traffic(topic=topic.name, payload_bytes=topic.payload_bytes, source_rate_hz=topic.source_rate_hz or 0.0)
        for topic in settings.topics
        if topic.payload_bytes is not None
    ]
    floors = sum(row.wire_bytes * row.min_rate_hz for row in rows_of_traffic(known, settings))
    link = settings.link
    key = "initial_capacity" if link.capacity_bytes_per_second is None else "capacity"
    usable = link.headroom * (link.capacity_bytes_per_second or link.initial_capacity_bytes_per_second)
    if floors > usable:
        yield (
            f"topics: warning: all min_rate_hz together need {format_rate(floors)} with headers, and link.{key} and "
            f"link.headroom leave {format_rate(usable)}; the lightest weights fall below theirs, so lower some"
        )


def _summary(settings: Settings, *, is_far: bool) -> Iterator[str]:
    """Yield what the file changes from the defaults, and what it means for the relay on this computer."""
    relay, differing = settings.relay, changes(Settings(), settings)
    has_one_end = relay.link_domain is None
    relayed = f", relayed: {len(relay.topics)}" if has_one_end else ""
    yield f"OK (topics: {len(settings.topics)}{relayed}, keys that differ from the default: {len(differing)})"
    if not has_one_end:
        yield from _two_ends(relay, is_far=is_far)
    elif is_far:
        yield "one end, on the robot: the relay has nothing to do on this side"
    elif relay.topics:
        yield f"one end: the base computer reads the relayed topics under {relay.prefix}"
    yield from (f"  {key}: {change}" for key, change in differing.items())


def _two_ends(relay: RelaySettings, *, is_far: bool) -> Iterator[str]:
    here, there = (relay.base, relay.robot) if is_far else (relay.robot, relay.base)
    other = f"the other end at {there}" if there else f"the other end finds this one at {here}"
    to_base, to_robot = (", ".join(patterns) or "nothing" for patterns in (relay.to_base, relay.to_robot))
    yield f"two ends: link domain {relay.link_domain}, {other}; to the base computer {to_base}; to the robot {to_robot}"
    named = {"deny": relay.deny, "services": relay.services, "actions": relay.actions}
    named["groups"] = tuple(group.name for group in relay.groups)
    parts = [f"{key} {', '.join(names)}" for key, names in named.items() if names]
    if relay.namespace:
        parts.append(f"names on the base computer under {relay.namespace}")
    if parts:
        yield "; ".join(parts)


CHECK = Command(_TEXT, _add_options, _check)
