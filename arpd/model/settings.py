"""What an operator may choose, as frozen domain values; ``config`` builds them from YAML."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

AUTO = "auto"  # of link.interface: arpd chooses
DEFAULT_RELAY_DEPTH = 10  # what every rclpy tutorial passes to create_publisher


class OnStop(StrEnum):
    """What a clean stop of the daemon does with the publishers."""

    RESTORE = "restore"
    KEEP = "keep"


class OnLost(StrEnum):
    """What the publishers do when they hear nothing of the daemon any more."""

    KEEP = "keep"
    BASELINE = "baseline"


class Backend(StrEnum):
    """Solver of the program."""

    OSQP = "osqp"
    EXACT = "exact"
    CVXPY = "cvxpy"


class Overflow(StrEnum):
    """What the pacing queue does with more than it may send."""

    LATEST = "latest"  # conflate: keep the newest sample only
    QUEUE = "queue"  # FIFO of at most depth samples, the oldest dropped and counted


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkSettings:
    """The link.

    Parameters
    ----------
    interface : interface name, or ``auto`` (the one that carries the default route, a wireless one first)
    capacity_bytes_per_second : pin the capacity; foreign traffic is still subtracted; None = estimate (bytes/s)
    initial_capacity_bytes_per_second : belief before the first evidence (bytes/s)
    headroom : η, the share of the capacity that may be planned, 0..1
    packet_overhead_s : pin t_ovh, the link time per packet beyond its bytes; None = estimate (s)
    """

    interface: str = AUTO
    capacity_bytes_per_second: float | None = None
    initial_capacity_bytes_per_second: float = 2.5e6
    headroom: float = 0.85
    packet_overhead_s: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicSettings:
    """One topic's wishes; None in rate or budget means "as measured" or "no cap".

    Parameters
    ----------
    weight : share of link time relative to others
    min_rate_hz : floor (Hz)
    max_rate_hz : desired rate (Hz); None = the rate the application publishes at
    min_depth, max_depth : bounds of DEPTH (samples)
    latency_budget_s : cap on the time a full history stands for (s); deeper is bufferbloat after an outage
    payload_bytes : serialized size of a sample, for `arpd solve` (bytes); None = measured, as the daemon always does
    source_rate_hz : rate the application publishes at, for `arpd solve` (Hz); None = measured, the same
    """

    weight: float = 1.0
    min_rate_hz: float = 1.0
    max_rate_hz: float | None = None
    min_depth: int = 1
    max_depth: int = 5000
    latency_budget_s: float | None = 1.0
    payload_bytes: float | None = None
    source_rate_hz: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramSettings:
    """The program: back end, the paper's Rmin as a reserve, deadline slack, memory budget.

    Parameters
    ----------
    backend : solver that answers first; ``exact`` cross-checks it
    deadline_slack : offered period = slack / R, ≥ 1
    memory_budget_bytes : M, memory all histories may take (bytes)
    memory_reserve_bytes : memory of the host that histories must leave free (bytes)
    """

    backend: Backend = Backend.OSQP
    deadline_slack: float = 1.25
    memory_budget_bytes: float = 64 * 2**20
    memory_reserve_bytes: float = 128 * 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class GovernorSettings:
    """When a measured change becomes a QoS swap (docs/design.md, The governor).

    Parameters
    ----------
    down_ratio, up_ratio : act when ηĈ is below / above this multiple of the level in force
    hold_s : for that long
    dwell_s, dwell_max_s : least time between an applied level and the next rise; doubles up to the maximum
    deadband : relative change of a topic's rate or depth below which its QoS is not swapped
    swaps_per_minute : budget of topic swaps
    debounce_s : quiet time after topics come or go before a new plan
    """

    down_ratio: float = 0.8
    up_ratio: float = 1.2
    hold_s: float = 2.0
    dwell_s: float = 5.0
    dwell_max_s: float = 40.0
    deadband: float = 0.1
    swaps_per_minute: int = 240
    debounce_s: float = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class HttpSettings:
    """Where metrics, health and status are served.

    Parameters
    ----------
    host, port : where to listen
    web_config : file with TLS and users as Prometheus exporters have it, or ``none``
    """

    host: str = "127.0.0.1"
    port: int = 9464
    web_config: str = "none"


@dataclass(frozen=True, kw_only=True, slots=True)
class RelaySettings:
    """What the relay carries for nodes whose code is not yours.

    Parameters
    ----------
    topics : topics to carry, by name
    prefix : the carried topic is ``prefix + name``
    overflow : per topic, how pacing overflows; ``latest`` when not named
    depths : per topic, the KEEP_LAST depth before the first plan; 10 when not named
    """

    topics: tuple[str, ...] = ()
    prefix: str = "/link"
    overflow: dict[str, Overflow] = field(default_factory=dict)
    depths: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphSettings:
    """Pinned topic counts, None = count the live graph."""

    sensing_topics: int | None = None
    actuation_topics: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """The whole configuration; ``topics`` maps a topic name to its wishes, ``default_topic`` serves the rest.

    Parameters
    ----------
    on_lost, lost_after_s : what publishers do when they heard nothing of the daemon for that long (s)
    """

    link: LinkSettings = field(default_factory=LinkSettings)
    program: ProgramSettings = field(default_factory=ProgramSettings)
    governor: GovernorSettings = field(default_factory=GovernorSettings)
    http: HttpSettings = field(default_factory=HttpSettings)
    relay: RelaySettings = field(default_factory=RelaySettings)
    graph: GraphSettings = field(default_factory=GraphSettings)
    default_topic: TopicSettings = field(default_factory=TopicSettings)
    topics: dict[str, TopicSettings] = field(default_factory=dict)
    on_stop: OnStop = OnStop.RESTORE
    on_lost: OnLost = OnLost.KEEP
    lost_after_s: float = 30.0

    @property
    def lease_s(self) -> float:
        """Silence after which a publisher returns to its application's QoS, 0 = never (s)."""
        return self.lost_after_s if self.on_lost is OnLost.BASELINE else 0.0

    def topic(self, name: str) -> TopicSettings:
        """Return the wishes for the topic called ``name``."""
        return self.topics.get(name, self.default_topic)
