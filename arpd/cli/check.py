"""`arpd check`: names the faults of a configuration, or says what it means."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.model.errors import ConfigError
from arpd.model.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from arpd.model.settings import RelaySettings


def add_check(commands: argparse._SubParsersAction[argparse.ArgumentParser], *, default_config: Path) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        "check",
        help="check a configuration file",
        description="""\
Check a configuration file exactly as the daemon does. Every fault is one line, FILE:LINE:COLUMN: KEY: what is wrong;
what would be right. A line with "warning:" is no fault: the key costs this host much memory, or the minimum rates do
not fit the link. Exits 0 without faults, 78 with.""",
        epilog="""\
examples:
  arpd check                                 checks /etc/arpd/arpd.yaml
  arpd check my.yaml && sudo systemctl reload arpd
  arpd check --far                           on the base computer, for `arpd relay --far` and `arpd peer`
  arpd check --no-interfaces robot.yaml      on another computer than the robot
  arpd check --json my.yaml | jq .settings   every key with the value in force""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", nargs="?", type=Path, default=default_config, help="YAML file (default %(default)s)")
    parser.add_argument(
        "--far", action="store_true", help="check for the far end, on the base computer; link.interface is the robot's"
    )
    parser.add_argument(
        "--no-interfaces",
        action="store_true",
        help="do not compare with this computer: neither link.interface nor memory",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(handler=_check)


def _check(options: argparse.Namespace) -> int:
    from arpd.host.config.keys import flatten
    from arpd.host.config.load import load_settings, local_domain
    from arpd.web.web_config import check_web_config

    interfaces = None if options.far or options.no_interfaces else _list_interfaces
    try:
        settings = load_settings(options.file, interfaces=interfaces, local_domain=local_domain())
        if not options.far:
            check_web_config(settings.http, directory=options.file.parent)
    except ConfigError as error:
        if not options.json:
            raise
        print(json.dumps({"ok": False, "file": str(options.file), "faults": error.faults}, indent=2))
        return error.exit_code
    found = [] if options.far else _warnings(settings, is_here=not options.no_interfaces)
    warned = [f"{options.file}: {warning}" for warning in found]
    if options.json:
        document = {"ok": True, "file": str(options.file), "warnings": warned, "settings": flatten(settings)}
        print(json.dumps(document, indent=2))
        return 0
    for warning in warned:
        print(warning, file=sys.stderr)
    print(_summary(settings, is_far=options.far))
    return 0


def _warnings(settings: Settings, *, is_here: bool) -> list[str]:
    from arpd.host.config.advice import warnings
    from arpd.host.interface import MemoryReader

    return list(warnings(settings, host_bytes=MemoryReader().read().total_bytes if is_here else 0))


def _list_interfaces() -> list[str] | None:
    from arpd.host.interface import list_interfaces

    if (names := list_interfaces()) is None:
        print("arpd: the kernel does not list this host's interfaces; link.interface is not checked", file=sys.stderr)
    return names


def _summary(settings: Settings, *, is_far: bool) -> str:
    """Say what the file changes from the defaults, and what it means for the relay on this computer."""
    from arpd.host.config.keys import changes

    relay = settings.relay
    differing = changes(Settings(), settings)
    relayed = f", relayed: {len(relay.topics)}" if relay.link_domain is None else ""
    ok = f"OK (topics: {len(settings.topics)}{relayed}, keys that differ from the default: {len(differing)})"
    meaning = _two_ends(relay, is_far=is_far) if relay.link_domain is not None else _one_end(relay, is_far=is_far)
    return "\n".join([ok, *meaning, *(f"  {key}: {change}" for key, change in differing.items())])


def _one_end(relay: RelaySettings, *, is_far: bool) -> Iterator[str]:
    if is_far:
        yield "one end, on the robot: the relay has nothing to do on this side"
    elif relay.topics:
        yield f"one end: the base computer reads the relayed topics under {relay.prefix}"


def _two_ends(relay: RelaySettings, *, is_far: bool) -> Iterator[str]:
    here, there = (relay.base, relay.robot) if is_far else (relay.robot, relay.base)
    other = f"the other end at {there}" if there else f"the other end finds this one at {here}"
    to_base, to_robot = (", ".join(patterns) or "nothing" for patterns in (relay.to_base, relay.to_robot))
    yield f"two ends: link domain {relay.link_domain}, {other}; to the base computer {to_base}; to the robot {to_robot}"
    named = {"deny": relay.deny, "services": relay.services, "actions": relay.actions}
    parts = [f"{key} {', '.join(patterns)}" for key, patterns in named.items() if patterns]
    if relay.groups:
        parts.append(f"groups {', '.join(group.name for group in relay.groups)}")
    if relay.namespace:
        parts.append(f"names on the base computer under {relay.namespace}")
    if parts:
        yield "; ".join(parts)
