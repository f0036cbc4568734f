"""Turns a configuration file into `Settings`, or reports every fault with its line and column."""

from __future__ import annotations

import difflib
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from arpd.host.config.keys import SECTIONS, keys_of, kinds_of
from arpd.host.config.rules import broken_rules
from arpd.host.config.yaml_source import Fault, config_error, dotted, read_source
from arpd.model.kinds import shown
from arpd.model.quantities import printable
from arpd.model.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from pydantic_core import ErrorDetails

    from arpd.host.config.yaml_source import Location, YamlSource
    from arpd.model.settings import TopicSettings

_SETTINGS = TypeAdapter(Settings)
_NO_MAPPING = {"dataclass_type", "model_type", "model_attributes_type", "dict_type"}


def load_settings(
    path: Path, *, interfaces: Callable[[], Collection[str] | None] | None, local_domain: int | None = None
) -> Settings:
    """Read and check a configuration file.

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
    source = read_source(path)
    faults, spoilt = list(source.faults), frozenset[Any]()
    try:
        settings = _SETTINGS.validate_python(source.data)
    except ValidationError as error:
        details = error.errors(include_url=False)
        known = {path: list(keys_of(section)) for path, section in SECTIONS.items()}
        faults += (reworded(each, source, known) for each in details)
        spoilt = frozenset(_spoilt(each["loc"]) for each in details)
        # The rules need settings, too: one wrong value hides no other fault.
        settings = _SETTINGS.validate_python(_without(source.data, spoilt))
    settings = replace(settings, topics=_inherited(settings, source, spoilt))
    faults += broken_rules(
        settings, source, spoilt, interfaces=interfaces() if interfaces else None, local_domain=local_domain
    )
    if faults:
        raise config_error(path, faults)
    return settings


def in_force(old: Settings, new: Settings) -> Settings:
    """Return the settings after a reload: ``new``, but with the old values of keys that are read at start only."""
    return replace(new, http=old.http, relay=old.relay, link=replace(new.link, interface=old.link.interface))


def local_domain(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the domain that rcl takes from the environment; None if ROS_DOMAIN_ID is no number, which rcl refuses."""
    try:
        return int(environment.get("ROS_DOMAIN_ID") or "0", base=0)
    except ValueError:
        return None


def reworded(details: ErrorDetails, source: YamlSource, known: Mapping[tuple[str, ...], Collection[str]]) -> Fault:
    """Return the fault behind an error of pydantic.

    Parameters
    ----------
    known : keys of every section, by its location without list positions
    """
    location: Location = details["loc"]
    section = known.get(tuple(step for step in location if isinstance(step, str)), ())
    value = source.value(location)
    match details["type"]:
        case "unexpected_keyword_argument" | "extra_forbidden":
            text = f"unknown key; {_nearest(location, known)}"
            return Fault(place=source.keys[location], key=dotted(location), text=text)
        case "missing":
            text = f"is missing; add `{location[-1]}:`"
        case kind if kind in _NO_MAPPING:
            wrong = "has no value" if value is None else f"{shown(value)} is not a mapping"
            keys = f" ({', '.join(section)})" if section else ""
            text = f"{wrong}; give it keys{keys} or leave it out"
        case "tuple_type":
            wrong = "has no value" if value is None else f"{shown(value)} is not a list"
            text = f"{wrong}; write a list, or [] for none"
        case "value_error":
            text = str(details["ctx"]["error"])
        case _:
            text = f"{printable(details['msg'])}; see the manual"
    return source.fault(location, text)


def _nearest(location: Location, known: Mapping[tuple[str, ...], Collection[str]]) -> str:
    """Suggest a key that looks like the wrong one, or list the known keys."""
    *above, wrong = (step for step in location if isinstance(step, str))
    here = known[tuple(above)]
    if near := difflib.get_close_matches(wrong[:100].lower(), here, n=1):
        return f"did you mean {near[0]}?"
    if elsewhere := [".".join((*path, wrong)) for path, keys in known.items() if wrong in keys]:
        return f"did you mean {elsewhere[0]}?"
    return f"known here: {', '.join(here)}"


def _spoilt(location: Location) -> Location:
    """Return what a fault makes useless: a value, or the whole item of a list whose name or topics are at fault."""
    for length, step in enumerate(location):
        above = tuple(step for step in location[:length] if isinstance(step, str))
        if step in {"name", "topics"} and above in {("topics",), ("relay", "topics"), ("relay", "groups")}:
            return location[:length]
    return location


def _without(value: Any, spoilt: Collection[Location], location: Location = ()) -> Any:
    """Return plain data without what is at fault."""
    if isinstance(value, dict):
        inner = {key: (*location, key) for key in value}
        return {key: _without(value[key], spoilt, inner[key]) for key in value if inner[key] not in spoilt}
    if isinstance(value, list):
        places = [(*location, index) for index in range(len(value))]
        kept = [(each, place) for each, place in zip(value, places, strict=True) if place not in spoilt]
        return [_without(each, spoilt, place) for each, place in kept]
    return value


def _inherited(settings: Settings, source: YamlSource, spoilt: Collection[Location]) -> tuple[TopicSettings, ...]:
    """Return the entries of ``topics`` with ``defaults`` for keys that they leave out, without the floor."""
    shared = kinds_of(SECTIONS["defaults",]).keys() - {"min_rate_hz"}
    topics = []
    for location, topic in source.items(("topics",), settings.topics, spoilt):
        absent = [keys_of(SECTIONS["defaults",])[key][0] for key in shared - source.value(location).keys()]
        topics.append(replace(topic, **{attribute: getattr(settings.defaults, attribute) for attribute in absent}))
    return tuple(topics)
