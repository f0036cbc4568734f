"""`arpd check`: names the faults of a configuration, or what it changes."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from arpd.cli.options import DEFAULT_CONFIG, Command, add_json
from arpd.host.addresses import own_address
from arpd.host.config.keys import changes, flatten
from arpd.host.config.load import domain_of_units, load_settings
from arpd.host.interface import list_interfaces
from arpd.model.errors import ConfigError
from arpd.model.quantities import format_rate
from arpd.model.settings import Settings, TopicSettings
from arpd.solve.topics import Traffic, rows_of_traffic
from arpd.web.web_config import load_protection

if TYPE_CHECKING:
    import argparse

_TEXT = """\
Check a configuration file exactly as the daemon does. Every fault is one line, FILE:LINE:COLUMN: KEY: what is wrong;
what would be right. Without faults it prints the keys that differ from the default, KEY: default -> value; a topic has
no minimum rate of its own by default. A line with "warning:" is no fault: the minimum rates do not fit the link. Exits
0 without faults, 78 with.

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
    parser.add_argument("--no-interfaces", action="store_true", help="interface and addresses are another computer's")
    parser.add_argument(
        "--late-interface", action="store_true", help="link.interface may come later, as for the daemon"
    )
    add_json(parser)


def _check(options: argparse.Namespace) -> int:
    knows_none = options.far or options.no_interfaces or options.late_interface
    interfaces = None if knows_none else list_interfaces
    try:
        settings = load_settings(options.file, interfaces=interfaces, local_domain=domain_of_units())
        if not options.no_interfaces:
            own_address(options.file, settings.relay.link(is_far=options.far), is_far=options.far)
        if not options.far:
            load_protection(settings.http, directory=options.file.parent)
    except ConfigError as error:
        if not options.json:
            raise
        print(json.dumps({"ok": False, "file": str(options.file), "faults": error.faults}, indent=2))
        return error.exit_code
    warnings = [] if options.far else _warnings(settings)
    if options.json:
        about = {"ok": True, "file": str(options.file), "warnings": warnings, "settings": flatten(settings)}
        print(json.dumps(about, indent=2))
        return 0
    for warning in warnings:
        print(f"{options.file}: {warning}", file=sys.stderr)
    given = asdict(Settings(defaults=settings.defaults).topic(""))
    usual = Settings(topics=tuple(TopicSettings(name=topic.name, **given) for topic in settings.topics))
    differing = changes(usual, settings)
    print(f"OK (topics: {len(settings.topics)}, keys that differ from the default: {len(differing)})")
    for key, change in differing.items():
        print(f"  {key}: {change}")
    return 0


def _warnings(settings: Settings) -> list[str]:
    """Return the warning that the minimum rates of the topics whose payload is known exceed the link, if they do."""
    known = [
        Traffic(topic=topic.name, payload_bytes=topic.payload_bytes, source_rate_hz=topic.source_rate_hz or 0.0)
        for topic in settings.topics
        if topic.payload_bytes is not None
    ]
    floors = sum(row.wire_bytes * row.min_rate_hz for row in rows_of_traffic(known, settings))
    link = settings.link
    key = "initial_capacity" if link.capacity_bytes_per_second is None else "capacity"
    usable = link.headroom * (link.capacity_bytes_per_second or link.initial_capacity_bytes_per_second)
    text = (
        f"topics: warning: all min_rate_hz together need {format_rate(floors)} with headers, and link.{key} and "
        f"link.headroom leave {format_rate(usable)}; the lightest weights fall below theirs, so lower some"
    )
    return [text] if floors > usable else []


CHECK = Command(_TEXT, _add_options, _check)
