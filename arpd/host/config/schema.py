"""The keys of arpd.yaml and their conversion to `Settings`, which also has every default."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field

from arpd.host.config.kinds import (
    DURATION,
    NONE,
    RATE,
    SIZE,
    Address,
    Choice,
    Count,
    GroupedTopic,
    ListOf,
    NamePattern,
    Namespace,
    Number,
    Quantity,
    Text,
    TopicName,
    ValueKind,
    Written,
)
from arpd.model.settings import (
    DEFAULT_RELAY_DEPTH,
    Backend,
    GovernorSettings,
    GraphSettings,
    HttpSettings,
    LinkSettings,
    OnLost,
    OnStop,
    Overflow,
    Policy,
    ProgramSettings,
    RelaySettings,
    Settings,
    TopicGroup,
    TopicSettings,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_DEFAULT = Settings()
_RELAY_OVERFLOW = Overflow.LATEST  # the default of RelaySettings
_PATTERNS = ListOf(item=NamePattern(), range="a list of names and patterns such as [/scan, /camera/**]")


class Section(BaseModel):
    """A mapping of the file; each field is a value with one `ValueKind`, or a further section."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @classmethod
    def kinds(cls) -> dict[str, ValueKind]:
        """Return the kind of every key that holds a value."""
        return {
            key: cast("ValueKind", kind)
            for key, field in cls.model_fields.items()
            for kind in field.metadata
            if hasattr(kind, "write")
        }

    def attributes(self) -> dict[str, Any]:
        """Return the values by the names of the settings attributes, units included."""
        return {key + kind.suffix: getattr(self, key) for key, kind in self.kinds().items()}


class Link(Section):
    """``link``."""

    interface: Annotated[
        str, Text(pattern=r"[!-.0-9;-~]{1,15}", what="an interface name", range="auto or an interface of this host")
    ] = _DEFAULT.link.interface
    capacity: Annotated[float | None, Quantity(unit=RATE, low="8kbit", high="100gbit", word="auto")] = (
        _DEFAULT.link.capacity_bytes_per_second
    )
    initial_capacity: Annotated[float, Quantity(unit=RATE, low="8kbit", high="100gbit")] = (
        _DEFAULT.link.initial_capacity_bytes_per_second
    )
    headroom: Annotated[float, Number(low=0.05, high=1)] = _DEFAULT.link.headroom
    packet_overhead: Annotated[float | None, Quantity(unit=DURATION, low="0s", high="100ms", word="auto")] = (
        _DEFAULT.link.packet_overhead_s
    )


class ProgramSection(Section):
    """``program``."""

    policy: Annotated[Policy, Choice(Policy)] = _DEFAULT.program.policy
    backend: Annotated[Backend, Choice(Backend)] = _DEFAULT.program.backend
    deadline_slack: Annotated[float, Number(low=1, high=100)] = _DEFAULT.program.deadline_slack
    memory_budget: Annotated[float, Quantity(unit=SIZE, low="64KiB", high="1024GiB")] = (
        _DEFAULT.program.memory_budget_bytes
    )
    memory_reserve: Annotated[float, Quantity(unit=SIZE, low="0B", high="1024GiB")] = (
        _DEFAULT.program.memory_reserve_bytes
    )


class Governor(Section):
    """``governor``."""

    hold: Annotated[float, Quantity(unit=DURATION, low="0s", high="1h")] = _DEFAULT.governor.hold_s
    dwell: Annotated[float, Quantity(unit=DURATION, low="0s", high="1h")] = _DEFAULT.governor.dwell_s
    debounce: Annotated[float, Quantity(unit=DURATION, low="0s", high="1h")] = _DEFAULT.governor.debounce_s


class Http(Section):
    """``http``."""

    host: Annotated[
        str, Text(pattern=r"[A-Za-z0-9.:_-]{1,253}", what="an address", range="an IP address or a host name")
    ] = _DEFAULT.http.host
    port: Annotated[int, Count(low=0, high=65535)] = _DEFAULT.http.port
    web_config: Annotated[str, Text(pattern=r"[^\0\r\n]{1,4096}", what="a path", range="a path or none")] = (
        _DEFAULT.http.web_config
    )


class Graph(Section):
    """``graph``."""

    sensing_topics: Annotated[int | None, Count(low=0, high=10_000, word="auto")] = _DEFAULT.graph.sensing_topics
    actuation_topics: Annotated[int | None, Count(low=0, high=10_000, word="auto")] = _DEFAULT.graph.actuation_topics


class TopicPreferences(Section):
    """``defaults``: the preferences of a topic without an entry of its own."""

    weight: Annotated[float, Number(low=0.001, high=1000)] = _DEFAULT.default_topic.weight
    min_rate_hz: Annotated[float, Number(low=0, high=100_000)] = _DEFAULT.default_topic.min_rate_hz
    max_rate_hz: Annotated[float | None, Number(low=0.001, high=100_000, word="source")] = (
        _DEFAULT.default_topic.max_rate_hz
    )
    min_depth: Annotated[int, Count(low=1, high=5000)] = _DEFAULT.default_topic.min_depth
    max_depth: Annotated[int, Count(low=1, high=5000)] = _DEFAULT.default_topic.max_depth
    latency_budget: Annotated[float | None, Quantity(unit=DURATION, low="1ms", high="1h", word="none")] = (
        _DEFAULT.default_topic.latency_budget_s
    )


class NamedTopicPreferences(TopicPreferences):
    """The preferences of one topic, and its assumed traffic, which ``defaults`` does not have."""

    payload: Annotated[float | None, Quantity(unit=SIZE, low="1B", high="1GB", word="measured")] = (
        _DEFAULT.default_topic.payload_bytes
    )
    source_rate_hz: Annotated[float | None, Number(low=0.001, high=100_000, word="measured")] = (
        _DEFAULT.default_topic.source_rate_hz
    )


class TopicEntry(NamedTopicPreferences):
    """One item of ``topics``; it takes the keys that it leaves out from ``defaults``."""

    name: Annotated[str, TopicName()]

    def settings(self, default: TopicSettings) -> TopicSettings:
        """Return the topic's preferences over those of ``defaults``."""
        given = {
            key + kind.suffix: getattr(self, key)
            for key, kind in NamedTopicPreferences.kinds().items()
            if key in self.model_fields_set
        }
        return replace(default, is_floor_inherited="min_rate_hz" not in given, **given)


class RelayTopic(Section):
    """One item of ``relay.topics``."""

    name: Annotated[str, TopicName()]
    overflow: Annotated[Overflow | None, Choice(Overflow)] = None
    depth: Annotated[int | None, Count(low=1, high=5000)] = None


class GroupBy(StrEnum):
    """Feature that the samples of a set have in common."""

    STAMP = "stamp"


class RelayGroup(Section):
    """One item of ``relay.groups``."""

    name: Annotated[str | None, TopicName()] = None
    topics: Annotated[
        tuple[str, ...], ListOf(item=GroupedTopic(), range="a list of names such as [/left/image, /right/image]")
    ]
    by: Annotated[GroupBy, Choice(GroupBy)] = GroupBy.STAMP


class Relay(Section):
    """``relay``."""

    link_domain: Annotated[int | None, Count(low=0, high=232, word=NONE)] = _DEFAULT.relay.link_domain
    robot: Annotated[str | None, Address()] = _DEFAULT.relay.robot
    base: Annotated[str | None, Address()] = _DEFAULT.relay.base
    namespace: Annotated[str, Namespace()] = _DEFAULT.relay.namespace
    to_base: Annotated[tuple[str, ...], _PATTERNS] = _DEFAULT.relay.to_base
    to_robot: Annotated[tuple[str, ...], _PATTERNS] = _DEFAULT.relay.to_robot
    deny: Annotated[tuple[str, ...], _PATTERNS] = _DEFAULT.relay.deny
    services: Annotated[tuple[str, ...], _PATTERNS] = _DEFAULT.relay.services
    actions: Annotated[tuple[str, ...], _PATTERNS] = _DEFAULT.relay.actions
    call_timeout: Annotated[float, Quantity(unit=DURATION, low="100ms", high="1h")] = _DEFAULT.relay.call_timeout_s
    groups: Annotated[tuple[RelayGroup, ...], Field(strict=False)] = ()
    prefix: Annotated[str, TopicName()] = _DEFAULT.relay.prefix
    topics: Annotated[tuple[RelayTopic, ...], Field(strict=False)] = ()

    def settings(self) -> RelaySettings:
        """Return the relay's settings."""
        return RelaySettings(
            **self.attributes(),
            topics=tuple(topic.name for topic in self.topics),
            groups=tuple(TopicGroup(name=group.name or group.topics[0], topics=group.topics) for group in self.groups),
            overflow={topic.name: topic.overflow for topic in self.topics if topic.overflow is not None},
            depths={topic.name: topic.depth for topic in self.topics if topic.depth is not None},
        )


class Document(Section):
    """The whole file."""

    link: Link = Link()
    program: ProgramSection = ProgramSection()
    governor: Governor = Governor()
    http: Http = Http()
    graph: Graph = Graph()
    defaults: TopicPreferences = TopicPreferences()
    topics: Annotated[tuple[TopicEntry, ...], Field(strict=False)] = ()
    relay: Relay = Relay()
    on_stop: Annotated[OnStop, Choice(OnStop)] = _DEFAULT.on_stop
    on_lost: Annotated[OnLost, Choice(OnLost)] = _DEFAULT.on_lost
    lost_after: Annotated[float, Quantity(unit=DURATION, low="5s", high="1h")] = _DEFAULT.lost_after_s

    def settings(self) -> Settings:
        """Return the settings that the file asks for."""
        default_topic = TopicSettings(is_floor_inherited=True, **self.defaults.attributes())
        return Settings(
            link=LinkSettings(**self.link.attributes()),
            program=ProgramSettings(**self.program.attributes()),
            governor=GovernorSettings(**self.governor.attributes()),
            http=HttpSettings(**self.http.attributes()),
            graph=GraphSettings(**self.graph.attributes()),
            relay=self.relay.settings(),
            default_topic=default_topic,
            topics={topic.name: topic.settings(default_topic) for topic in self.topics},
            **self.attributes(),
        )


# Every section by its location, without list positions.
SECTIONS: Mapping[tuple[str, ...], type[Section]] = {
    (): Document,
    ("link",): Link,
    ("program",): ProgramSection,
    ("governor",): Governor,
    ("http",): Http,
    ("graph",): Graph,
    ("defaults",): TopicPreferences,
    ("topics",): TopicEntry,
    ("relay",): Relay,
    ("relay", "groups"): RelayGroup,
    ("relay", "topics"): RelayTopic,
}


def flatten(settings: Settings) -> dict[str, Written]:
    """Return every key with its value as the file writes it: ``{"link.capacity": "20mbit", …}``."""
    return dict(_rows(settings))


def _rows(settings: Settings) -> Iterator[tuple[str, Written]]:
    yield from _written("link", Link, settings.link)
    yield from _written("program", ProgramSection, settings.program)
    yield from _written("governor", Governor, settings.governor)
    yield from _written("http", Http, settings.http)
    yield from _written("graph", Graph, settings.graph)
    yield from _written("defaults", TopicPreferences, settings.default_topic)
    for name, preferences in settings.topics.items():
        yield from _written(f"topics[{name}]", NamedTopicPreferences, preferences)
    yield from _written("relay", Relay, settings.relay)
    for group in settings.relay.groups:
        yield f"relay.groups[{group.name}].topics", list(group.topics)
        yield f"relay.groups[{group.name}].by", str(GroupBy.STAMP)
    for name in settings.relay.topics:
        yield f"relay.topics[{name}].overflow", str(settings.relay.overflow.get(name, _RELAY_OVERFLOW))
        yield f"relay.topics[{name}].depth", settings.relay.depths.get(name, DEFAULT_RELAY_DEPTH)
    for key, kind in Document.kinds().items():
        yield key, kind.write(getattr(settings, key + kind.suffix))


def _written(path: str, section: type[Section], values: object) -> Iterator[tuple[str, Written]]:
    for key, kind in section.kinds().items():
        yield f"{path}.{key}", kind.write(getattr(values, key + kind.suffix))


def spelled(value: Written) -> str:
    """Return a value on one line, as the file has it: ``[/scan, /camera/**]``."""
    return f"[{', '.join(value)}]" if isinstance(value, list) else str(value)
