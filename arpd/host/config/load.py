"""Turns a configuration file into `Settings`, or reports every fault with its line and column."""

from __future__ import annotations

import difflib
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from arpd.host.config.keys import SECTIONS
from arpd.host.config.rules import broken_rules
from arpd.host.config.yaml_source import Fault, config_error, dotted, read_source
from arpd.model.kinds import shown
from arpd.model.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from pathlib import Path

    from pydantic_core import ErrorDetails

    from arpd.host.config.yaml_source import Location, YamlSource
    from arpd.model.settings import TopicSettings

_SETTINGS = TypeAdapter(Settings)
_LISTS = {("topics",), ("relay", "topics"), ("relay", "groups")}


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
    faults = list(source.faults)
    try:
        settings = _SETTINGS.validate_python(source.data)
    except ValidationError as error:
        details = error.errors(include_url=False)
        faults += (_reworded(each, source) for each in details)
        source.spoilt.update(_spoilt(each["loc"]) for each in details)
        # The rules need settings, too: one wrong value hides no other fault.
        settings = _SETTINGS.validate_python(_without(source.data, source.spoilt))
    settings = replace(settings, topics=_inherited(settings, source))
    faults += broken_rules(settings, source, interfaces=interfaces() if interfaces else None, local_domain=local_domain)
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


def _reworded(details: ErrorDetails, source: YamlSource) -> Fault:
    """Return the fault behind an error of pydantic."""
    location: Location = details["loc"]
    value, kind = source.value(location), details["type"]
    if kind in {"unexpected_keyword_argument", "extra_forbidden"}:
        return Fault(source.keys[location], dotted(location), f"unknown key; {_nearest(location)}")
    wrong = "has no value" if value is None else f"{shown(value)} is not"
    if kind == "missing":
        text = f"is missing; add `{location[-1]}:`"
    elif kind == "value_error":
        text = str(details["ctx"]["error"])
    elif kind == "tuple_type":
        text = f"{wrong}{'' if value is None else ' a list'}; write a list, or [] for none"
    else:
        keys = SECTIONS.get(_path(location), {})
        listed = f" ({', '.join(keys)})" if keys else ""
        text = f"{wrong}{'' if value is None else ' a mapping'}; give it keys{listed} or leave it out"
    return source.fault(location, text)


def _path(location: Location) -> tuple[str, ...]:
    """Return a location without positions in lists."""
    return tuple(step for step in location if isinstance(step, str))


def _nearest(location: Location) -> str:
    """Suggest a key that looks like the wrong one, or list the known keys."""
    *above, wrong = _path(location)
    here = SECTIONS[*above,]
    if near := difflib.get_close_matches(wrong[:100].lower(), here, n=1):
        return f"did you mean {near[0]}?"
    if elsewhere := [".".join((*path, wrong)) for path, keys in SECTIONS.items() if wrong in keys]:
        return f"did you mean {elsewhere[0]}?"
    return f"known here: {', '.join(here)}"


def _spoilt(location: Location) -> Location:
    """Return what a fault makes useless: a value, or the whole item of a list whose name or topics are at fault."""
    for length, step in enumerate(location):
        if step in {"name", "topics"} and _path(location[:length]) in _LISTS:
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


def _inherited(settings: Settings, source: YamlSource) -> tuple[TopicSettings, ...]:
    """Return the entries of ``topics`` with ``defaults`` for keys that they leave out, without the floor."""
    shared = {name: key.attribute for name, key in SECTIONS["defaults",].items() if name != "min_rate_hz"}
    topics = []
    for location, topic in source.items(("topics",), settings.topics):
        absent = shared.keys() - source.value(location).keys()
        topics.append(replace(topic, **{shared[name]: getattr(settings.defaults, shared[name]) for name in absent}))
    return tuple(topics)
