"""Rules between keys: no minimum above its maximum, no name given twice, an interface that exists.

The rules read the raw file instead of the finished model, so they work even if another value is wrong. They ignore a
value that is itself at fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.host.config.domain import shared_domain
from arpd.host.config.kinds import NONE, GroupedTopic
from arpd.host.config.schema import Link, Relay, RelayGroup, RelayTopic, Section, TopicEntry, TopicPreferences
from arpd.host.config.yaml_source import Fault, Location, Place, dotted
from arpd.model.names import LONGEST_NAME

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from arpd.host.config.yaml_source import YamlSource

_ONE_ENDED = frozenset({"link_domain", "prefix", "topics"})  # keys of `relay` that do not need two ends
_PREFERENCE_PAIRS = (("min_rate_hz", "max_rate_hz"), ("min_depth", "max_depth"))


def broken_rules(
    source: YamlSource, *, interfaces: Collection[str] | None, local_domain: int | None
) -> Iterator[Fault]:
    """Yield the faults that no single value shows.

    Parameters
    ----------
    source : the file
    interfaces : names of this host's interfaces, None = unknown
    local_domain : ROS domain of this host's own nodes, None = unknown
    """
    if interfaces is not None:
        yield from _missing_interface(source, interfaces)
    for low, high in _PREFERENCE_PAIRS:
        yield from _unordered(source, ("defaults",), TopicPreferences, low, high)
        for location in _items(source, ("topics",)):
            yield from _unordered(source, location, TopicEntry, low, high, fallback=_mapping(source, ("defaults",)))
    yield from _repeated_names(source, ("topics",), TopicEntry)
    yield from _repeated_names(source, ("relay", "topics"), RelayTopic)
    yield from _repeated_names(source, ("relay", "groups"), RelayGroup)
    yield from _bad_groups(source)
    relay = _mapping(source, ("relay",))
    if relay.get("link_domain", NONE) == NONE:
        yield from _bad_relayed_names(source)
        yield from _unused_keys(source, relay)
    elif (link_domain := _value(Relay, "link_domain", relay)) is not None:
        yield from _bad_link_domain(source, relay, link_domain, local_domain)
        yield from _long_far_names(source, relay)
        yield from _named_members(source)


def _missing_interface(source: YamlSource, interfaces: Collection[str]) -> Iterator[Fault]:
    name = _value(Link, "interface", _mapping(source, ("link",)))
    if name is None or name == "auto" or name in interfaces:
        return
    existing = ", ".join(sorted(interfaces)) or "none"
    wrong = f"'{name}' does not exist on this host; write auto or one of {existing}"
    yield source.fault(("link", "interface"), wrong)


def _unordered(
    source: YamlSource,
    location: Location,
    section: type[Section],
    low: str,
    high: str,
    *,
    fallback: dict[str, Any] | None = None,
) -> Iterator[Fault]:
    """Yield a fault if the minimum is above its maximum, at the one of the two that the file names here."""
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
        yield source.fault((*location, low), wrong)
    elif high in here:
        wrong = f"{high_text} is below {low} {low_text} (the default); raise it or lower {low}"
        yield source.fault((*location, high), wrong)


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


def _bad_relayed_names(source: YamlSource) -> Iterator[Fault]:
    """Yield names that are too long with the prefix, and names under it, which would become ``/link/link/…``."""
    prefix = _value(Relay, "prefix", _mapping(source, ("relay",)))
    for location in _items(source, ("relay", "topics")):
        name = _value(RelayTopic, "name", _mapping(source, location))
        if not prefix or not name:
            continue
        if (length := len(prefix) + len(name)) > LONGEST_NAME:
            wrong = f"with its prefix is {length} characters long; ROS allows {LONGEST_NAME}"
            yield source.fault((*location, "name"), wrong)
        if name == prefix:
            wrong = f"'{name}' is relay.prefix itself; name a topic, or change prefix"
            yield source.fault((*location, "name"), wrong)
        elif name.startswith(f"{prefix}/"):
            wrong = f"'{name}' lies under relay.prefix {prefix}, where relayed topics go; write {name[len(prefix) :]}"
            yield source.fault((*location, "name"), wrong)


def _unused_keys(source: YamlSource, relay: dict[str, Any]) -> Iterator[Fault]:
    """Yield the keys that say something about two ends, although there is one."""
    default = Relay()
    for key in Relay.model_fields.keys() - _ONE_ENDED:
        value = _value(Relay, key, relay) if key in Relay.kinds() else tuple(_items(source, ("relay", key)))
        if value is not None and value != getattr(default, key):
            wrong = "needs relay.link_domain; give that a number, or remove this key"
            yield source.fault(("relay", key), wrong)


def _bad_link_domain(
    source: YamlSource, relay: dict[str, Any], link_domain: int, local_domain: int | None
) -> Iterator[Fault]:
    """Yield a domain that this host's own nodes use, and ends of which neither knows the other's address."""
    if wrong := shared_domain(link_domain, local_domain):
        yield source.fault(("relay", "link_domain"), wrong)
    if all(relay.get(end, NONE) == NONE for end in ("robot", "base")):
        wrong = "needs the address of one end, or nobody would find the other; give relay.robot or relay.base"
        yield source.fault(("relay", "link_domain"), wrong)


def _long_far_names(source: YamlSource, relay: dict[str, Any]) -> Iterator[Fault]:
    """Yield names that are too long on the base computer, where they have the namespace in front."""
    namespace = _value(Relay, "namespace", relay) or ""
    named = [(*location, "name") for location in _items(source, ("relay", "topics"))]
    for location in (*named, *_grouped(source)):
        name = source.value(location)
        if isinstance(name, str) and len(name) <= LONGEST_NAME < (length := len(namespace) + len(name)):
            wrong = f"with relay.namespace is {length} characters long; ROS allows {LONGEST_NAME}"
            yield source.fault(location, wrong)


def _bad_groups(source: YamlSource) -> Iterator[Fault]:
    """Yield groups of fewer than two topics, topics of two groups, and groups named like a topic of another group."""
    for location in _items(source, ("relay", "groups")):
        topics = source.value((*location, "topics"))
        if isinstance(topics, list) and len(topics) < 2:
            count = "one topic" if topics else "no topic"
            yield source.fault((*location, "topics"), f"has {count}; name at least two, or remove the group")
    first: dict[str, Location] = {}
    for location in _grouped(source):
        name = source.value(location)
        if not _is_topic(name):
            continue
        if name in first:
            wrong = f"'{name}' is already in a group on line {source.place(first[name]).line}; keep one of the two"
            yield source.fault(location, wrong)
        else:
            first[name] = location
    for location in _items(source, ("relay", "groups")):
        name = _value(RelayGroup, "name", _mapping(source, location))
        if name in first and first[name][: len(location)] != location:
            wrong = f"'{name}' is a topic of the group on line {source.place(first[name]).line}; choose another name"
            yield source.fault((*location, "name"), wrong)


def _named_members(source: YamlSource) -> Iterator[Fault]:
    """Yield settings of a topic that crosses under the name of its group, which nothing would read."""
    group_of: dict[str, str] = {}
    for location in _items(source, ("relay", "groups")):
        members = [source.value(topic) for topic in _items(source, (*location, "topics"))]
        group = {"name": next(iter(members), None)} | _mapping(source, location)
        if (name := _value(RelayGroup, "name", group)) is not None:
            group_of = {member: name for member in members if _is_topic(member) and member != name} | group_of
    for path, section in ((("topics",), TopicEntry), (("relay", "topics"), RelayTopic)):
        for location in _items(source, path):
            name = _value(section, "name", _mapping(source, location))
            if name in group_of:
                wrong = f"'{name}' is in group {group_of[name]}; set this for the group"
                yield source.fault((*location, "name"), wrong)


def _grouped(source: YamlSource) -> list[Location]:
    """Return the places of all topics of all groups."""
    groups = _items(source, ("relay", "groups"))
    return [
        topic
        for location in groups
        if isinstance(source.value(location), dict)
        for topic in _items(source, (*location, "topics"))
    ]


def _is_topic(name: Any) -> bool:
    try:
        GroupedTopic().read(name)
    except ValueError:
        return False
    return True


def _mapping(source: YamlSource, location: Location) -> dict[str, Any]:
    value = source.value(location)
    return value if isinstance(value, dict) else {}


def _items(source: YamlSource, path: Location) -> list[Location]:
    value = source.value(path)
    return [(*path, index) for index in range(len(value))] if isinstance(value, list) else []


def _value(section: type[Section], key: str, mapping: dict[str, Any]) -> Any:
    """Return the value of the key or its default, None without either or if the value is at fault."""
    if key not in mapping:
        field = section.model_fields[key]
        return None if field.is_required() else field.get_default()
    try:
        return section.kinds()[key].read(mapping[key])
    except ValueError:
        return None
