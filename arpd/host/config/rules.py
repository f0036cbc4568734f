"""Rules between keys: no minimum above its maximum, no name given twice, an interface that exists."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

from arpd.model.names import LONGEST_NAME
from arpd.model.settings import AUTO, RelaySettings, RelayTopic, Settings, TopicGroup, TopicSettings, key_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from arpd.host.config.yaml_source import Fault, Location, YamlSource

_ONE_ENDED = frozenset({"link_domain", "prefix", "topics"})  # keys of `relay` that do not need two ends


def broken_rules(
    settings: Settings, source: YamlSource, *, interfaces: Collection[str] | None, local_domain: int | None
) -> Iterator[Fault]:
    """Yield the faults that no single value shows.

    Parameters
    ----------
    interfaces : names of this host's interfaces, None = unknown
    local_domain : ROS domain of this host's own nodes, None = unknown
    """
    relay, name = settings.relay, settings.link.interface
    if interfaces is not None and name not in {AUTO, *interfaces}:
        existing = ", ".join(sorted(interfaces)) or "none"
        wrong = f"'{name}' does not exist on this host; write auto or one of {existing}"
        yield source.fault(("link", "interface"), wrong)
    named, carried = _names(("topics",), settings.topics), _names(("relay", "topics"), relay.topics)
    yield from _unordered(settings, source)
    yield from _repeated(source, named)
    yield from _repeated(source, carried)
    yield from _mixed_groups(source, relay.groups)
    for index, topic in enumerate(settings.topics):
        for key in ("payload", "source_rate_hz"):
            if topic.is_pattern and (place := ("topics", index, key)) in source.values:
                yield source.fault(place, "belongs to one topic; name it without stars, or remove this key")
    if relay.link_domain is None:
        yield from _bad_relayed_names(source, relay.prefix, carried)
        yield from _unused_keys(source, relay)
        return
    yield from _bad_ends(source, relay, local_domain)
    # Nothing would read the settings of a topic that crosses under the name of its group.
    group_of = {member: group.name for group in relay.groups for member in group.topics if member != group.name}
    for location, name in named + carried:
        if name in group_of:
            yield source.fault(location, f"'{name}' is in group {group_of[name]}; set this for the group")


def _bad_ends(source: YamlSource, relay: RelaySettings, local_domain: int | None) -> Iterator[Fault]:
    if relay.link_domain == local_domain:
        wrong = f"{local_domain} is the domain of this computer's own nodes (ROS_DOMAIN_ID); choose another"
        yield source.fault(("relay", "link_domain"), wrong)
    robot_loops, base_loops = ((each or "").startswith(("127.", "localhost")) for each in (relay.robot, relay.base))
    if relay.robot is relay.base is None:
        wrong = "needs the address of one end, or nobody would find the other; give relay.robot or relay.base"
        yield source.fault(("relay", "link_domain"), wrong)
    elif robot_loops != base_loops:
        key, own = ("robot", relay.robot) if robot_loops else ("base", relay.base)
        yield source.fault(("relay", key), f"{own} is every computer's own; write the address on the link, or none")
    elif relay.robot == relay.base and not robot_loops:
        wrong = f"{relay.base} is relay.robot, too; write the base computer's own address, or none"
        yield source.fault(("relay", "base"), wrong)


def _names(above: Location, entries: Sequence[TopicSettings | RelayTopic]) -> list[tuple[Location, str]]:
    return [((*above, index, "name"), entry.name) for index, entry in enumerate(entries)]


def _unordered(settings: Settings, source: YamlSource) -> Iterator[Fault]:
    """Yield a fault where a minimum is above its maximum, and the entry names one of the two."""
    places: list[Location] = [("defaults",), *(("topics", index) for index in range(len(settings.topics)))]
    for place, entry in zip(places, (settings.defaults, *settings.topics), strict=True):
        least_hz = settings.defaults.min_rate_hz if entry.min_rate_hz is None else entry.min_rate_hz
        rates = ("min_rate_hz", least_hz, "max_rate_hz", entry.max_rate_hz)
        for low_key, low, high_key, high in (rates, ("min_depth", entry.min_depth, "max_depth", entry.max_depth)):
            own = [(*place, key) for key in (low_key, high_key) if (*place, key) in source.values]
            if own and high is not None and low > high:
                wrong = f"{low_key} {low:g} is above {high_key} {high:g}; lower {low_key} or raise {high_key}"
                yield source.fault(own[0], wrong)


def _repeated(source: YamlSource, names: list[tuple[Location, str]]) -> Iterator[Fault]:
    first: dict[str, Location] = {}
    for location, name in names:
        if first.setdefault(name, location) != location:
            wrong = f"'{name}' is already given on line {source.values[first[name]][0]}; keep one of the two"
            yield source.fault(location, wrong)


def _mixed_groups(source: YamlSource, groups: Sequence[TopicGroup]) -> Iterator[Fault]:
    """Yield topics that are given twice, and groups named like another group or a topic of it."""
    names: list[tuple[Location, str]] = []
    for at, group in enumerate(groups):
        names += [(("relay", "groups", at, "topics", index), topic) for index, topic in enumerate(group.topics)]
        if group.name not in group.topics:
            names.append((("relay", "groups", at, "name"), group.name))
    yield from _repeated(source, names)


def _bad_relayed_names(source: YamlSource, prefix: str, names: list[tuple[Location, str]]) -> Iterator[Fault]:
    """Yield names that are too long with the prefix, and names under it, which would become ``/link/link/…``."""
    for location, name in names:
        if len(prefix + name) > LONGEST_NAME:
            wrong = f"with its prefix is {len(prefix + name)} characters long; ROS allows {LONGEST_NAME}"
            yield source.fault(location, wrong)
        if f"{name}/".startswith(f"{prefix}/"):
            right = name.removeprefix(prefix) or "a topic"
            wrong = f"'{name}' lies under relay.prefix {prefix}, where relayed topics go; write {right}"
            yield source.fault(location, wrong)


def _unused_keys(source: YamlSource, relay: RelaySettings) -> Iterator[Fault]:
    """Yield the keys that say something about two ends, although there is one."""
    for each in fields(RelaySettings):
        key = key_of(each.name)
        if key not in _ONE_ENDED and getattr(relay, each.name) != getattr(RelaySettings(), each.name):
            yield source.fault(("relay", key), "needs relay.link_domain; give that a number, or remove this key")
