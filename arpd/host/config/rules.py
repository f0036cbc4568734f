"""Rules between keys: no minimum above its maximum, no name given twice, an interface that exists."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.host.config.keys import keys_of
from arpd.model.names import LONGEST_NAME
from arpd.model.settings import AUTO, RelaySettings

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from arpd.host.config.yaml_source import Fault, Location, YamlSource
    from arpd.model.settings import RelayTopic, Settings, TopicGroup, TopicSettings

_ONE_ENDED = frozenset({"link_domain", "prefix", "topics"})  # keys of `relay` that do not need two ends


def broken_rules(
    settings: Settings, source: YamlSource, *, interfaces: Collection[str] | None, local_domain: int | None
) -> Iterator[Fault]:
    """Yield the faults that no single value shows.

    Parameters
    ----------
    settings : of the file, without what is at fault
    source : the file
    interfaces : names of this host's interfaces, None = unknown
    local_domain : ROS domain of this host's own nodes, None = unknown
    """
    relay, name = settings.relay, settings.link.interface
    if interfaces is not None and name not in {AUTO, *interfaces}:
        existing = ", ".join(sorted(interfaces)) or "none"
        wrong = f"'{name}' does not exist on this host; write auto or one of {existing}"
        yield source.fault(("link", "interface"), wrong)
    topics = source.items(("topics",), settings.topics)
    relayed = source.items(("relay", "topics"), relay.topics)
    yield from _unordered(settings, source, topics)
    yield from _repeated(source, _names(topics))
    yield from _repeated(source, _names(relayed))
    yield from _mixed_groups(source, source.items(("relay", "groups"), relay.groups))
    for location, topic in topics:
        for key in ("payload", "source_rate_hz"):
            if topic.is_pattern and (*location, key) in source.values:
                yield source.fault((*location, key), "belongs to one topic; name it without stars, or remove this key")
    if relay.link_domain is not None:
        yield from _bad_ends(relay, source, local_domain)
        yield from _grouped(source, relay, [*_names(topics), *_names(relayed)])
    elif source.spoilt.isdisjoint({("relay", "link_domain"), ("relay", "prefix")}):
        yield from _bad_relayed_names(source, relay.prefix, relayed)
        yield from _unused_keys(source, relay)


def _bad_ends(relay: RelaySettings, source: YamlSource, local_domain: int | None) -> Iterator[Fault]:
    """Yield a domain that this host's own nodes use, and ends of which neither knows the other's address."""
    if relay.link_domain == local_domain:
        wrong = f"{local_domain} is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
        yield source.fault(("relay", "link_domain"), wrong)
    if relay.robot is relay.base is None and source.spoilt.isdisjoint({("relay", "robot"), ("relay", "base")}):
        wrong = "needs the address of one end, or nobody would find the other; give relay.robot or relay.base"
        yield source.fault(("relay", "link_domain"), wrong)


def _grouped(source: YamlSource, relay: RelaySettings, names: list[tuple[Location, str]]) -> Iterator[Fault]:
    """Yield settings of a topic that crosses under the name of its group, which nothing would read."""
    group_of = {member: group.name for group in relay.groups for member in group.topics if member != group.name}
    for place, name in names:
        if name in group_of:
            yield source.fault(place, f"'{name}' is in group {group_of[name]}; set this for the group")


def _names(entries: Iterable[tuple[Location, TopicSettings | RelayTopic]]) -> list[tuple[Location, str]]:
    return [((*location, "name"), entry.name) for location, entry in entries]


def _unordered(settings: Settings, source: YamlSource, topics: list[tuple[Location, TopicSettings]]) -> Iterator[Fault]:
    """Yield a fault where a minimum is above its maximum, at the one of the two that the file names there."""
    for location, entry in [(("defaults",), settings.defaults), *topics]:
        least_hz = settings.defaults.min_rate_hz if entry.min_rate_hz is None else entry.min_rate_hz
        rates = ("min_rate_hz", least_hz, "max_rate_hz", entry.max_rate_hz)
        for low_key, low, high_key, high in (rates, ("min_depth", entry.min_depth, "max_depth", entry.max_depth)):
            places = [
                (*location, key) if (*location, key) in source.values else ("defaults", key)
                for key in (low_key, high_key)
            ]
            if high is None or low <= high or not source.spoilt.isdisjoint(places):
                continue
            if places[0][:-1] == location:
                yield source.fault(places[0], f"{low:g} is above {high_key} {high:g}; lower it or raise {high_key}")
            elif places[1][:-1] == location:
                yield source.fault(places[1], f"{high:g} is below {low_key} {low:g}; raise it or lower {low_key}")


def _repeated(source: YamlSource, names: list[tuple[Location, str]]) -> Iterator[Fault]:
    first: dict[str, Location] = {}
    for location, name in names:
        if first.setdefault(name, location) != location:
            wrong = f"'{name}' is already given on line {source.values[first[name]].line}; keep one of the two"
            yield source.fault(location, wrong)


def _mixed_groups(source: YamlSource, groups: list[tuple[Location, TopicGroup]]) -> Iterator[Fault]:
    """Yield groups of fewer than two topics, topics of two groups, and groups named like another group or its topic."""
    topics = [((*at, "topics", index), name) for at, group in groups for index, name in enumerate(group.topics)]
    yield from _repeated(source, topics)
    for location, group in groups:
        if len(group.topics) < 2:
            yield source.fault((*location, "topics"), "has fewer than two topics; name more, or remove the group")
    names = [((*at, "name"), group.name) for at, group in groups if (*at, "name") in source.values]
    yield from _repeated(source, names)
    for place, name in names:
        first = next((other for other, topic in topics if topic == name and other[:3] != place[:3]), None)
        if first is not None:
            wrong = f"'{name}' is a topic of the group on line {source.values[first].line}; choose another name"
            yield source.fault(place, wrong)


def _bad_relayed_names(source: YamlSource, prefix: str, relayed: list[tuple[Location, RelayTopic]]) -> Iterator[Fault]:
    """Yield names that are too long with the prefix, and names under it, which would become ``/link/link/…``."""
    for location, topic in relayed:
        name = topic.name
        if len(prefix + name) > LONGEST_NAME:
            wrong = f"with its prefix is {len(prefix + name)} characters long; ROS allows {LONGEST_NAME}"
            yield source.fault((*location, "name"), wrong)
        if f"{name}/".startswith(f"{prefix}/"):
            right = name.removeprefix(prefix) or "a topic"
            wrong = f"'{name}' lies under relay.prefix {prefix}, where relayed topics go; write {right}"
            yield source.fault((*location, "name"), wrong)


def _unused_keys(source: YamlSource, relay: RelaySettings) -> Iterator[Fault]:
    """Yield the keys that say something about two ends, although there is one."""
    for key, (attribute, _) in keys_of(RelaySettings).items():
        if key not in _ONE_ENDED and getattr(relay, attribute) != getattr(RelaySettings(), attribute):
            yield source.fault(("relay", key), "needs relay.link_domain; give that a number, or remove this key")
