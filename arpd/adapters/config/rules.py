"""Rules between keys: ranges the right way round, names given once, an interface that exists.

They read the raw file rather than the finished model, so that one wrong value elsewhere does not hide them; a value
that is itself at fault takes part in no rule.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.adapters.config.kinds import LONGEST_TOPIC
from arpd.adapters.config.schema import Governor, Link, Relay, RelayTopic, Section, TopicEntry, TopicPreferences
from arpd.adapters.config.yaml_source import Fault, Location, Place, dotted

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from arpd.adapters.config.yaml_source import YamlSource

_PREFERENCE_PAIRS = (("min_rate_hz", "max_rate_hz"), ("min_depth", "max_depth"))


def broken_rules(source: YamlSource, *, interfaces: Collection[str] | None) -> Iterator[Fault]:
    """Find what each value alone cannot show.

    Parameters
    ----------
    source : the file
    interfaces : names of the interfaces of this host; None = not known here
    """
    if interfaces is not None:
        yield from _missing_interface(source, interfaces)
    yield from _unordered(source, ("governor",), Governor, "dwell", "dwell_max")
    for low, high in _PREFERENCE_PAIRS:
        yield from _unordered(source, ("defaults",), TopicPreferences, low, high)
        for location in _items(source, ("topics",)):
            yield from _unordered(source, location, TopicEntry, low, high, fallback=_mapping(source, ("defaults",)))
    yield from _repeated_names(source, ("topics",), TopicEntry)
    yield from _repeated_names(source, ("relay", "topics"), RelayTopic)
    yield from _long_relayed_names(source)
    yield from _relayed_outputs(source)


def _missing_interface(source: YamlSource, interfaces: Collection[str]) -> Iterator[Fault]:
    name = _value(Link, "interface", _mapping(source, ("link",)))
    if name is None or name == "auto" or name in interfaces:
        return
    existing = ", ".join(sorted(interfaces)) or "none"
    yield _fault(
        source, ("link", "interface"), f"'{name}' does not exist on this host; write auto or one of {existing}"
    )


def _unordered(
    source: YamlSource,
    location: Location,
    section: type[Section],
    low: str,
    high: str,
    *,
    fallback: dict[str, Any] | None = None,
) -> Iterator[Fault]:
    """Report a minimum above its maximum, at whichever of the two the file names here."""
    here = _mapping(source, location)
    inherited = {key: value for key, value in (fallback or {}).items() if key not in here}
    low_value = _value(section, low, inherited | here)
    high_value = _value(section, high, inherited | here)
    if low_value is None or high_value is None or low_value <= high_value:
        return
    write = section.kinds()[low].write
    low_text, high_text = write(low_value), write(high_value)
    if low in here:
        origin = "" if high in here else " (the default)"
        wrong = f"{low_text} is above {high} {high_text}{origin}; lower it or raise {high}"
        yield _fault(source, (*location, low), wrong)
    elif high in here:
        wrong = f"{high_text} is below {low} {low_text} (the default); raise it or lower {low}"
        yield _fault(source, (*location, high), wrong)


def _repeated_names(source: YamlSource, path: tuple[str, ...], section: type[Section]) -> Iterator[Fault]:
    first: dict[str, Place] = {}
    for location in _items(source, path):
        name = _value(section, "name", _mapping(source, location))
        if name is None:
            continue
        place = source.values[*location, "name"]
        if name in first:
            wrong = f"'{name}' is already given on line {first[name].line}; keep one of the two"
            yield Fault(place=place, key=dotted((*location, "name")), text=wrong)
        else:
            first[name] = place


def _long_relayed_names(source: YamlSource) -> Iterator[Fault]:
    prefix = _value(Relay, "prefix", _mapping(source, ("relay",)))
    for location in _items(source, ("relay", "topics")):
        name = _value(RelayTopic, "name", _mapping(source, location))
        if prefix and name and len(prefix) + len(name) > LONGEST_TOPIC:
            wrong = f"with its prefix is {len(prefix) + len(name)} characters long; ROS allows {LONGEST_TOPIC}"
            yield _fault(source, (*location, "name"), wrong)


def _relayed_outputs(source: YamlSource) -> Iterator[Fault]:
    """Report a topic that is relayed already, by its name: carried again, it would nest as ``/link/link/…``."""
    prefix = _value(Relay, "prefix", _mapping(source, ("relay",)))
    for location in _items(source, ("relay", "topics")):
        name = _value(RelayTopic, "name", _mapping(source, location))
        if not prefix or not name:
            continue
        if name == prefix:
            wrong = f"'{name}' is relay.prefix itself; name a topic, or change prefix"
            yield _fault(source, (*location, "name"), wrong)
        elif name.startswith(f"{prefix}/"):
            wrong = f"'{name}' lies under relay.prefix {prefix}, where relayed topics go; write {name[len(prefix) :]}"
            yield _fault(source, (*location, "name"), wrong)


def _mapping(source: YamlSource, location: Location) -> dict[str, Any]:
    """Return the mapping there, empty if there is none."""
    value = _at(source, location)
    return value if isinstance(value, dict) else {}


def _items(source: YamlSource, path: tuple[str, ...]) -> list[Location]:
    """Return the locations of a list's items, none if there is no list."""
    value = _at(source, path)
    return [(*path, index) for index in range(len(value))] if isinstance(value, list) else []


def _at(source: YamlSource, location: Location) -> Any:
    value: Any = source.data
    for step in location:
        if isinstance(step, int):
            value = value[step]  # only `_items` makes one
        elif isinstance(value, dict):
            value = value.get(step)
        else:
            return None
    return value


def _value(section: type[Section], key: str, mapping: dict[str, Any]) -> Any:
    """Return what the key has, or its default; None where there is neither, or the value is at fault."""
    if key not in mapping:
        field = section.model_fields[key]
        return None if field.is_required() else field.get_default()
    try:
        return section.kinds()[key].read(mapping[key])
    except ValueError:
        return None


def _fault(source: YamlSource, location: Location, text: str) -> Fault:
    return Fault(place=source.values[location], key=dotted(location), text=text)
