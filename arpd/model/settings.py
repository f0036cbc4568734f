"""Settings of the operator: every key of arpd.yaml with its kind and its default.

The shipped file, etc/arpd/arpd.yaml, explains each of them. None stands for the word in a key's `or_word`. A key is
called like its attribute, without the unit: ``hold: 2s`` is ``hold_s``.

Programs make settings from base units, without checks. `arpd.host.config` reads them from YAML: pydantic finds the kind
of each value in its annotation.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Annotated, Any, ClassVar

from pydantic import Field

from arpd.model.endpoints import Overflow
from arpd.model.kinds import NONE, Address, NamePattern, Namespace, Prefix, TopicName, duration, or_word, rate, size
from arpd.model.names import compile_patterns
from arpd.model.wire import MOST_DOMAIN, domain_port

AUTO = "auto"  # for link.interface: arpd chooses
DEFAULT_RELAY_DEPTH = 10  # what every rclpy tutorial passes to create_publisher
_LISTENING = r"^([A-Za-z0-9._-]{1,253}|[0-9A-Fa-f]{0,4}:[0-9A-Fa-f:]{0,35}:[0-9A-Fa-f.]{0,15})$"


def key_of(attribute: str) -> str:
    """Return the key that an attribute has in the file."""
    return re.sub("_(bytes_per_second|bytes|s)$", "", attribute)


class Section:
    """A mapping of the file: each attribute is a value with its kind, a further section or a tuple of sections."""

    __slots__ = ()
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid", "alias_generator": key_of}


class OnStop(StrEnum):
    """Treatment of publishers when the daemon stops cleanly."""

    RESTORE = "restore"
    KEEP = "keep"


class OnLost(StrEnum):
    """Behaviour of publishers that no longer hear the daemon."""

    KEEP = "keep"
    BASELINE = "baseline"


class Policy(StrEnum):
    """Division of the link among the topics."""

    PER_TOPIC = "per_topic"  # each by its weight, floor and desired rate: (G1) and (G2)
    UNIFORM = "uniform"  # one rate and one depth for all: Eq. (4) of the paper


class Backend(StrEnum):
    """Solver of the program."""

    OSQP = "osqp"
    CLOSED_FORM = "closed_form"
    CVXPY = "cvxpy"


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkSettings(Section):
    """Settings of the link."""

    interface: Annotated[str, Field(pattern=r"^[!-.0-9;-~]{1,15}$")] = AUTO
    capacity_bytes_per_second: Annotated[float | None, *rate("8kbit", "100gbit"), *or_word(AUTO)] = None
    initial_capacity_bytes_per_second: Annotated[float, *rate("8kbit", "100gbit")] = 2.5e6
    headroom: Annotated[float, Field(ge=0.05, le=1)] = 0.85  # η
    packet_overhead_s: Annotated[float | None, *duration("0s", "100ms"), *or_word(AUTO)] = None  # t_ovh


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramSettings(Section):
    """Settings of the program."""

    policy: Policy = Policy.PER_TOPIC
    backend: Backend = Backend.OSQP
    deadline_slack: Annotated[float, Field(ge=1, le=100)] = 1.25
    memory_budget_bytes: Annotated[float, *size("64KiB", "1024GiB")] = 64 * 2**20  # M
    memory_reserve_bytes: Annotated[float, *size("0B", "1024GiB")] = 128 * 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class GovernorSettings(Section):
    """Thresholds that turn a measured change into a QoS swap (docs/design.md, The governor)."""

    hold_s: Annotated[float, *duration("0s", "1h")] = 2.0
    dwell_s: Annotated[float, *duration("0s", "1h")] = 10.0
    debounce_s: Annotated[float, *duration("0s", "1h")] = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class HttpSettings(Section):
    """Settings of the server of metrics, status and page."""

    host: Annotated[str, Field(pattern=_LISTENING)] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 9464
    web_config: Annotated[str | None, Field(pattern=r"^[^\x00\r\n]+$", max_length=4096), *or_word(NONE)] = None

    @property
    def netloc(self) -> str:
        """Host and port as a URL has them."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphSettings(Section):
    """Pinned topic counts; None = count the live graph."""

    sensing_topics: Annotated[int | None, Field(ge=0, le=10_000), *or_word(AUTO)] = None
    actuation_topics: Annotated[int | None, Field(ge=0, le=10_000), *or_word(AUTO)] = None

    @property
    def pinned(self) -> dict[str, Any]:
        """The counts that are given, by the names that an observation has for them."""
        return {each.name: count for each in fields(self) if (count := getattr(self, each.name)) is not None}


@dataclass(frozen=True, kw_only=True, slots=True)
class Preferences(Section):
    """Preferences for a topic."""

    weight: Annotated[float, Field(ge=0.001, le=1000)] = 1.0
    min_rate_hz: Annotated[float | None, Field(ge=0, le=100_000)] = None  # None: that of defaults, for small samples
    max_rate_hz: Annotated[float | None, Field(ge=0.001, le=100_000), *or_word("source")] = None
    min_depth: Annotated[int, Field(ge=1, le=5000)] = 1
    max_depth: Annotated[int, Field(ge=1, le=5000)] = 5000
    latency_budget_s: Annotated[float | None, *duration("1ms", "1h"), *or_word(NONE)] = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class DefaultPreferences(Preferences):
    """Preferences for topics without settings of their own."""

    min_rate_hz: Annotated[float, Field(ge=0, le=100_000)] = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicSettings(Preferences):
    """Preferences for one topic, or for all that a pattern matches."""

    name: NamePattern
    payload_bytes: Annotated[float | None, *size("1B", "1GB"), *or_word("measured")] = None
    source_rate_hz: Annotated[float | None, Field(ge=0.001, le=100_000), *or_word("measured")] = None

    @property
    def is_pattern(self) -> bool:
        """True if it may hold for several topics."""
        return "*" in self.name


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicGroup(Section):
    """Topics whose samples with one header stamp are thinned together."""

    name: TopicName = ""
    topics: Annotated[tuple[TopicName, ...], Field(min_length=2)]

    def __post_init__(self) -> None:
        if not self.name and self.topics:
            object.__setattr__(self, "name", self.topics[0])


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayTopic(Section):
    """Topic that the relay carries."""

    name: TopicName
    overflow: Overflow = Overflow.LATEST
    depth: Annotated[int | None, Field(ge=1, le=5000)] = None  # None: one that suits the samples


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkDomain:
    """ROS domain of the link, and the address of each end.

    Parameters
    ----------
    peer : the other end's, empty = it finds this one
    own : this end's, empty = not configured
    """

    domain_id: int
    peer: str
    own: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelaySettings(Section):
    """Topics that the relay carries for nodes whose code is not yours: under a prefix, or with two ends."""

    link_domain: Annotated[int | None, Field(ge=0, le=MOST_DOMAIN), *or_word(NONE)] = None
    robot: Annotated[Address | None, *or_word(NONE)] = None
    base: Annotated[Address | None, *or_word(NONE)] = None
    namespace: Namespace = ""
    to_base: tuple[NamePattern, ...] = ("/**",)
    to_robot: tuple[NamePattern, ...] = ("/**",)
    deny: tuple[NamePattern, ...] = ()
    services: tuple[NamePattern, ...] = ()
    actions: tuple[NamePattern, ...] = ()
    call_timeout_s: Annotated[float, *duration("100ms", "1h")] = 10.0
    groups: tuple[TopicGroup, ...] = ()
    prefix: Prefix = "/link"
    topics: tuple[RelayTopic, ...] = ()

    @property
    def topic_names(self) -> tuple[str, ...]:
        """Names of ``topics``."""
        return tuple(topic.name for topic in self.topics)

    @property
    def queued(self) -> frozenset[str]:
        """Names of the topics that lose no sample to pacing while their history holds it."""
        return frozenset(topic.name for topic in self.topics if topic.overflow is Overflow.QUEUE)

    @property
    def depths(self) -> dict[str, int]:
        """Depths that the operator has given, by topic."""
        return {topic.name: topic.depth for topic in self.topics if topic.depth is not None}

    @property
    def link_prefix(self) -> str:
        """Text that stands before the name of a carried topic on the link: nothing with two ends."""
        return self.prefix if self.link_domain is None else ""

    @property
    def ports(self) -> tuple[int, int]:
        """First and last UDP port of the link domain: of the four participants that one is announced to."""
        first = domain_port(self.link_domain or 0) + 10
        return first, first + 7

    def link(self, *, is_far: bool) -> LinkDomain | None:
        """Return the link as one end sees it; None for a relay with one end.

        Parameters
        ----------
        is_far : whether that end is the base computer's
        """
        if self.link_domain is None:
            return None
        own, other = (self.base, self.robot) if is_far else (self.robot, self.base)
        return LinkDomain(domain_id=self.link_domain, peer=other or "", own=own or "")


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings(Section):
    """Whole configuration."""

    link: LinkSettings = field(default_factory=LinkSettings)
    program: ProgramSettings = field(default_factory=ProgramSettings)
    governor: GovernorSettings = field(default_factory=GovernorSettings)
    http: HttpSettings = field(default_factory=HttpSettings)
    graph: GraphSettings = field(default_factory=GraphSettings)
    defaults: DefaultPreferences = field(default_factory=DefaultPreferences)
    topics: tuple[TopicSettings, ...] = ()
    relay: RelaySettings = field(default_factory=RelaySettings)
    on_stop: OnStop = OnStop.RESTORE
    on_lost: OnLost = OnLost.KEEP
    lost_after_s: Annotated[float, *duration("5s", "1h")] = 30.0
    _named: dict[str, Preferences] = field(default_factory=dict, init=False, repr=False, compare=False)
    _patterns: list[tuple[re.Pattern[str], Preferences]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        """Prepare what `topic` answers: names, then patterns, the most specific first, then the defaults."""
        if self.program.policy is not Policy.UNIFORM:
            patterns = [topic for topic in self.topics if topic.is_pattern]
            # First those with more characters besides stars, then those with fewer stars.
            patterns.sort(key=lambda topic: (-len(topic.name.replace("*", "")), topic.name.count("*")))
            self._named.update({topic.name: topic for topic in self.topics if not topic.is_pattern})
            self._patterns.extend((compile_patterns([topic.name]), topic) for topic in patterns)
        given = {each.name: getattr(self.defaults, each.name) for each in fields(Preferences)}
        self._patterns.append((re.compile(".*"), Preferences(**given | {"min_rate_hz": None})))

    @property
    def lease_s(self) -> float:
        """Silence of the daemon after which a publisher returns to its application's QoS, 0 = never (s)."""
        return self.lost_after_s if self.on_lost is OnLost.BASELINE else 0.0

    def topic(self, name: str) -> Preferences:
        """Return the preferences for a topic: its own, else those of the most specific pattern it matches.

        Under the uniform policy no topic has its own.
        """
        matching = (preferences for pattern, preferences in self._patterns if pattern.fullmatch(name))
        return self._named.get(name) or next(matching)
