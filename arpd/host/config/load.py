"""Turns a configuration file into `Settings`, or reports every fault with its line and column."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from arpd.host.config.keys import SECTIONS, SETTINGS, Sections, keys_at, nearest
from arpd.host.config.rules import broken_rules
from arpd.host.config.yaml_source import Fault, Location, YamlSource, dotted
from arpd.model.quantities import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from pydantic_core import ErrorDetails

    from arpd.model.settings import Settings

T = TypeVar("T")
OF_UNITS = Path("/etc/default/arpd")  # their environment


def load_settings(
    path: Path, *, interfaces: Callable[[], Collection[str] | None] | None, local_domain: int | None = None
) -> Settings:
    """Read and check a configuration file: first each key and value, then what they mean together.

    Parameters
    ----------
    path : YAML file
    interfaces : returns the names of this host's interfaces, None where they are unknown; None = do not check
        ``link.interface``
    local_domain : ROS domain of this host's own nodes, None = do not check ``relay.link_domain`` against it

    Raises
    ------
    ConfigError
        With every fault of the file, in its order.
    """
    source = YamlSource(path)
    validated(SETTINGS, source.data, source)
    # An entry of `topics` has the defaults of the file for what it leaves out, without the floor.
    shared = {key: value for key, value in source.data.get("defaults", {}).items() if key != "min_rate_hz"}
    topics = [shared | topic for topic in source.data.get("topics", ())]
    settings = validated(SETTINGS, source.data | {"topics": topics}, source)
    known = interfaces() if interfaces else None
    if broken := list(broken_rules(settings, source, interfaces=known, local_domain=local_domain)):
        raise source.error(broken)
    return settings


def validated(
    adapter: TypeAdapter[T], data: Any, source: YamlSource, *, sections: Sections = SECTIONS, context: Any = None
) -> T:
    """Return what the data of a file mean, or raise ConfigError with all that is wrong with single keys and values."""
    try:
        return adapter.validate_python(data, context=context)
    except ValidationError as error:
        raise source.error(_reworded(each, source, sections) for each in error.errors(include_url=False)) from None


def in_force(old: Settings, new: Settings) -> Settings:
    """Return the settings after a reload: ``new``, but with the old values of keys that are read at start only."""
    return replace(new, http=old.http, relay=old.relay, link=replace(new.link, interface=old.link.interface))


def local_domain(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the domain that rcl takes from the environment; None if ROS_DOMAIN_ID is no number, which rcl refuses."""
    try:
        text = environment.get("ROS_DOMAIN_ID") or "0"
        return int(text, base=8 if re.fullmatch("0[0-7]+", text) else 0)  # as strtoul(3), which rcl asks
    except ValueError:
        return None


def domain_of_units() -> int | None:
    """Return the domain of arpd's units and of the nodes beside them, which a shell need not have."""
    given: dict[str, str] = {}
    with suppress(OSError):
        text = OF_UNITS.read_text(errors="replace")
        given.update(re.findall(r'^\s*(ROS_DOMAIN_ID)\s*=\s*["\']?(\w*)', text, re.MULTILINE))
    return local_domain({**os.environ, **given})


def _reworded(details: ErrorDetails, source: YamlSource, sections: Sections) -> Fault:
    location: Location = details["loc"]
    shown = printable(str(details["input"]))
    match details["type"]:
        case "unexpected_keyword_argument":
            return Fault(source.keys[location], dotted(location), f"unknown key; {nearest(location, sections)}")
        case "missing":
            text = f"is missing; add `{location[-1]}:`"
        case "tuple_type":
            text = "is not a list; write a list, or [] for none"
        case "too_short":
            text = f"has too few items; give it {details['ctx']['min_length']} or more"
        case "dataclass_type" | "dict_type":
            text = f"is not a mapping; give it keys ({', '.join(keys_at(location, sections)) or '…'}) or leave it out"
        case _ if details["input"] is None:
            text = "has no value; write one, or leave the key out"
        case "value_error":
            text = str(details["ctx"]["error"])
            location = location[:-1] if location[-1] == "[key]" else location  # pydantic's mark of a name in a mapping
        case "string_pattern_mismatch":
            text = f"'{shown}' is empty, too long, or has a character that cannot be in it; correct it"
        case _:
            text = f"{shown} does not fit; {details['msg'].replace('Input', 'it').replace('String', 'it')}"
    return source.fault(location, text)
