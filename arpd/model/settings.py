"""Settings of the operator, as frozen values; `arpd.host.config` builds them from YAML."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

AUTO = "auto"  # for link.interface: arpd chooses
DEFAULT_RELAY_DEPTH = 10  # what every rclpy tutorial passes to create_publisher


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


class Overflow(StrEnum):
    """Treatment of samples above the paced rate."""

    LATEST = "latest"  # keep the newest sample only
    QUEUE = "queue"  # FIFO of at most depth samples; withhold the oldest


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkSettings:
    """Settings of the link.

    Parameters
    ----------
    interface : interface name, or ``auto`` (the one that carries the default route, a wireless one first)
    capacity_bytes_per_second : pinned capacity; cross traffic is still subtracted; None = estimate (bytes/s)
    initial_capacity_bytes_per_second : capacity to assume before the first evidence (bytes/s)
    headroom : η, the share of the capacity that may be planned, 0..1
    packet_overhead_s : pinned t_ovh, link time of a packet beyond its bytes; None = estimate (s)
    """

    interface: str = AUTO
    capacity_bytes_per_second: float | None = None
    initial_capacity_bytes_per_second: float = 2.5e6
    headroom: float = 0.85
    packet_overhead_s: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicSettings:
    """Preferences for one topic.

    Parameters
    ----------
    weight : share of link time relative to other topics
    min_rate_hz : floor (Hz)
    is_floor_inherited : whether the floor is that of ``defaults``, which holds for small samples only
    max_rate_hz : desired rate (Hz); None = the rate at which the application publishes
    min_depth, max_depth : bounds of DEPTH (samples)
    latency_budget_s : cap on the time that a full history stands for (s); more is bufferbloat after an outage;
        None = no cap
    payload_bytes : serialized size of a sample, for `arpd solve` (bytes); None = measured. The daemon always measures
    source_rate_hz : rate at which the application publishes, for `arpd solve` (Hz); None = measured
    """

    weight: float = 1.0
    min_rate_hz: float = 1.0
    max_rate_hz: float | None = None
    min_depth: int = 1
    max_depth: int = 5000
    latency_budget_s: float | None = 1.0
    payload_bytes: float | None = None
    source_rate_hz: float | None = None
    is_floor_inherited: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramSettings:
    """Settings of the program.

    Parameters
    ----------
    policy : division of the link among the topics
    backend : solver of the program; ``closed_form`` answers where another one fails
    deadline_slack : offered period = slack / R, ≥ 1
    memory_budget_bytes : M, memory that all histories may take (bytes)
    memory_reserve_bytes : memory that histories must leave free on the host (bytes)
    """

    policy: Policy = Policy.PER_TOPIC
    backend: Backend = Backend.OSQP
    deadline_slack: float = 1.25
    memory_budget_bytes: float = 64 * 2**20
    memory_reserve_bytes: float = 128 * 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class GovernorSettings:
    """Thresholds that turn a measured change into a QoS swap (docs/design.md, The governor).

    Parameters
    ----------
    hold_s : time that a change must last (s)
    dwell_s : least time between a plan and the next one for a change of the link (s)
    debounce_s : quiet time after topics come or go, before a new plan (s)
    """

    hold_s: float = 2.0
    dwell_s: float = 10.0
    debounce_s: float = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class HttpSettings:
    """Settings of the server of metrics, health and status.

    Parameters
    ----------
    host, port : address to listen on
    web_config : file with TLS and users in the format of Prometheus exporters, or ``none``
    """

    host: str = "127.0.0.1"
    port: int = 9464
    web_config: str = "none"


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicGroup:
    """Topics whose samples with one header stamp are thinned together; ``name`` stands for them in the program."""

    name: str
    topics: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkDomain:
    """ROS domain of the link, and the address of the other end, empty = it finds this one."""

    domain_id: int
    peer: str


@dataclass(frozen=True, kw_only=True, slots=True)
class RelaySettings:
    """Topics that the relay carries for nodes whose code is not yours: under a prefix, or with two ends.

    Parameters
    ----------
    topics : topics to carry under the prefix, by name; with two ends, topics with an overflow or a depth of their own
    prefix : with one end, the carried topic is ``prefix + name``
    overflow : treatment of samples above the paced rate, by topic; ``latest`` when not named
    depths : KEEP_LAST depth before the first plan, by topic; 10 when not named
    link_domain : ROS domain in which only arpd's processes live; None = one end, with the prefix
    robot, base : address of each end on the link; None = unknown, then the other one must be known
    namespace : stands before all of the robot's names on the base computer; empty = none
    to_base, to_robot : patterns of the topics that may cross in each direction
    deny : patterns of names that cross in neither
    services, actions : patterns of those that may be called across the link, from either side
    groups : topics thinned together
    call_timeout_s : time after which a service call without an answer has failed (s)
    """

    topics: tuple[str, ...] = ()
    prefix: str = "/link"
    overflow: dict[str, Overflow] = field(default_factory=dict)
    depths: dict[str, int] = field(default_factory=dict)
    link_domain: int | None = None
    robot: str | None = None
    base: str | None = None
    namespace: str = ""
    to_base: tuple[str, ...] = ("/**",)
    to_robot: tuple[str, ...] = ("/**",)
    deny: tuple[str, ...] = ()
    services: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    groups: tuple[TopicGroup, ...] = ()
    call_timeout_s: float = 10.0

    @property
    def link_prefix(self) -> str:
        """Text that stands before the name of a carried topic on the link: nothing with two ends."""
        return self.prefix if self.link_domain is None else ""

    def link(self, *, is_far: bool) -> LinkDomain | None:
        """Return the link as one end sees it; None for a relay with one end.

        Parameters
        ----------
        is_far : whether that end is the base computer's
        """
        if self.link_domain is None:
            return None
        return LinkDomain(domain_id=self.link_domain, peer=(self.robot if is_far else self.base) or "")


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphSettings:
    """Pinned topic counts; None = count the live graph."""

    sensing_topics: int | None = None
    actuation_topics: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """Whole configuration; ``topics`` maps a topic name to its preferences, ``default_topic`` serves the rest.

    Parameters
    ----------
    on_lost, lost_after_s : behaviour of publishers that have not heard the daemon for that long (s)
    """

    link: LinkSettings = field(default_factory=LinkSettings)
    program: ProgramSettings = field(default_factory=ProgramSettings)
    governor: GovernorSettings = field(default_factory=GovernorSettings)
    http: HttpSettings = field(default_factory=HttpSettings)
    relay: RelaySettings = field(default_factory=RelaySettings)
    graph: GraphSettings = field(default_factory=GraphSettings)
    default_topic: TopicSettings = field(default_factory=lambda: TopicSettings(is_floor_inherited=True))
    topics: dict[str, TopicSettings] = field(default_factory=dict)
    on_stop: OnStop = OnStop.RESTORE
    on_lost: OnLost = OnLost.KEEP
    lost_after_s: float = 30.0

    @property
    def lease_s(self) -> float:
        """Silence of the daemon after which a publisher returns to its application's QoS, 0 = never (s)."""
        return self.lost_after_s if self.on_lost is OnLost.BASELINE else 0.0

    def topic(self, name: str) -> TopicSettings:
        """Return the preferences for the topic called ``name``; under the uniform policy no topic has its own."""
        if self.program.policy is Policy.UNIFORM:
            return self.default_topic
        return self.topics.get(name, self.default_topic)
