"""Turns a configuration file into `Settings`, or reports every fault with its line and column."""

from __future__ import annotations

import difflib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from arpd.host.config.kinds import reworded, shown
from arpd.host.config.rules import broken_rules
from arpd.host.config.schema import SECTIONS, Document, Section, flatten, spelled
from arpd.host.config.yaml_source import Fault, config_error, dotted, read_source

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path

    from pydantic_core import ErrorDetails

    from arpd.host.config.yaml_source import Location, YamlSource
    from arpd.model.settings import Settings

_RESTART_ONLY = ("link.interface", "http.", "relay.")
_ABSENT = "absent"
# Keys of older versions.
_REMOVED = dict.fromkeys(
    ("governor.down_ratio", "governor.up_ratio", "governor.deadband", "governor.swaps_per_minute"),
    "was removed: DEPTH and DEADLINE now move in classes, within 1 % of the link; delete this line",
)


def load_settings(
    path: Path, *, interfaces: Callable[[], Collection[str] | None] | None, local_domain: int | None = None
) -> Settings:
    """Read and check a configuration file.

    Parameters
    ----------
    path : YAML file
    interfaces : returns the names of this host's interfaces, None where they are unknown; None = do not check
        ``link.interface``
    local_domain : ROS domain of this host's own nodes (`arpd.host.config.domain`), None = do not check
        ``relay.link_domain`` against it

    Raises
    ------
    ConfigError
        With every fault of the file, in its order.
    """
    source = read_source(path)
    faults = list(source.faults)
    document = None
    try:
        document = Document.model_validate(source.data)
    except ValidationError as error:
        faults += (_reworded(details, source) for details in error.errors(include_url=False))
    faults += broken_rules(source, interfaces=interfaces() if interfaces else None, local_domain=local_domain)
    if faults or document is None:
        raise config_error(path, faults)
    return document.settings()


def describe_change(old: Settings, new: Settings) -> list[str]:
    """Return one line ``key: old -> new`` for each key that differs."""
    before, after = ({key: spelled(value) for key, value in flatten(settings).items()} for settings in (old, new))
    return [f"{key}: {before.get(key, _ABSENT)} -> {after.get(key, _ABSENT)}" for key in _changed(old, new)]


def in_force(old: Settings, new: Settings) -> Settings:
    """Return the settings after a reload: ``new``, but with the old values of keys that are read at start only."""
    return replace(new, http=old.http, relay=old.relay, link=replace(new.link, interface=old.link.interface))


def restart_only_changes(old: Settings, new: Settings) -> list[str]:
    """Return the keys that differ but are read at start only, so that a reload cannot apply them."""
    return [key for key in _changed(old, new) if needs_restart(key)]


def needs_restart(key: str) -> bool:
    """Return whether a change of the dotted key takes effect only after a restart."""
    return key.startswith(_RESTART_ONLY)


def _changed(old: Settings, new: Settings) -> Iterator[str]:
    before, after = flatten(old), flatten(new)
    return (key for key in before | after if before.get(key) != after.get(key))


def _reworded(details: ErrorDetails, source: YamlSource) -> Fault:
    location: Location = details["loc"]
    match details["type"]:
        case "extra_forbidden":
            unknown = f"is not a key arpd knows; {_nearest(location)}"
            key = dotted(location)
            return Fault(place=source.keys[location], key=key, text=_REMOVED.get(key, unknown))
        case "missing":
            text = "is missing; give every item one"
        case "model_type":
            text = f"{_shape(details['input'], 'a mapping')}; {_keys(location)}"
        case "tuple_type":
            text = f"{_shape(details['input'], 'a list')}; {_items(location)}"
        case _:
            text = reworded(details)
    return source.fault(location, text)


def _section(location: Location) -> type[Section]:
    return SECTIONS[tuple(step for step in location if isinstance(step, str))]


def _nearest(location: Location) -> str:
    """Suggest a key that looks like the wrong one, or list the known keys."""
    known = list(_section(location[:-1]).model_fields)
    wrong = str(location[-1])
    if near := difflib.get_close_matches(wrong[:100].lower(), known, n=1):
        return f"did you mean {near[0]}?"
    elsewhere = [".".join((*path, wrong)) for path, section in SECTIONS.items() if wrong in section.model_fields]
    if elsewhere:
        return f"did you mean {elsewhere[0]}?"
    return f"known here: {', '.join(known)}"


def _shape(value: Any, wanted: str) -> str:
    return "has no value" if value is None else f"{shown(value)} is not {wanted}"


def _items(location: Location) -> str:
    """Return how to write the list there."""
    *above, last = location
    if kind := _section(tuple(above)).kinds().get(str(last)):
        return f"write {kind.range}"
    required = next(key for key, field in _section(location).model_fields.items() if field.is_required())
    return f"write items with `- {required}:`, or [] for none"


def _keys(location: Location) -> str:
    known: list[Any] = list(_section(location).model_fields)
    return f"give it keys ({', '.join(known)}) or leave it out"
