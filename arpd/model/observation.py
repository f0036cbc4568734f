"""Observation: everything one tick sees of the world."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.endpoints import PublisherState
    from arpd.model.interface import LinkCounters
    from arpd.model.probing import ClockOffset, PeerReport
    from arpd.model.relay import RelaySummary


class MessageKind(StrEnum):
    """Subject of a message that arrives."""

    PUBLISHERS = "publishers"
    REPORTS = "reports"
    PRICES = "prices"  # of other daemons


class MessageRefusal(StrEnum):
    """Reason not to believe a message, or a part of one."""

    SIZE = "size"  # longer than any honest message
    MALFORMED = "malformed"  # cannot be decoded, or has impossible values
    RATE = "rate"  # more often than any honest sender
    QUOTA = "quota"  # the source has as many entries as it may have, or none is free
    UNANSWERED = "unanswered"  # a report that answers no probe of this daemon


@dataclass(frozen=True, kw_only=True, slots=True)
class MemoryState:
    """Memory of the robot computer (psutil ``virtual_memory``)."""

    total_bytes: int
    available_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Surroundings:
    """What one tick sees of the world, and the status tells as it is.

    Parameters
    ----------
    memory : memory of the robot computer
    sensing_topics, actuation_topics : topics in the ROS graph that cross the link, managed by arpd or not
    rmw, rmw_refusal : middleware of ROS, and why arpd only paces publishers; empty if it can swap their writers
    other_daemons : where the other arpd daemons in the ROS domain are, in words
    active_daemon : where the active daemon is while this one stands by; empty if this one is active
    radio_bytes_per_second : bit rate at which the radio transmits (bytes/s); None without a radio or its answer
    relay : relay with two ends as its end on the robot tells it; None without one, and while that end is silent
    """

    memory: MemoryState
    sensing_topics: int
    actuation_topics: int
    rmw: str = ""
    rmw_refusal: str = ""
    other_daemons: tuple[str, ...] = ()
    active_daemon: str = ""
    radio_bytes_per_second: float | None = None
    relay: RelaySummary | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation(Surroundings):
    """Everything one tick sees of the world.

    Parameters
    ----------
    now_s : monotonic clock (s)
    counters : the robot's link interface, None while it cannot be read
    reports : peer reports that arrived since the last tick, oldest first
    publishers : live AdaptivePublishers
    peers : peers in the graph, None = not known; with none left, silence is no outage
    peer_ages_s : time since the last report of each peer heard in the last minute (s)
    peer_clocks : clocks of the peers against this host's, by peer; those that nothing tells are missing
    refused : messages, or parts of them, refused since the start, by kind and reason
    answers : of nodes to plans since the start, by result (``ok``, ``refused``, ``timeout``)
    pending : publishers that announce themselves but that the graph does not show (yet)
    left_out : publishers that arpd does not manage because there are too many, by node
    is_relay_silent : True when the robot's end of the relay should tell, and has told nothing for 4.5 s
    domain : ROS domain in which publishers and peers are looked for, None without ROS
    remote_participants : processes across the link, each of which hears of every writer that comes or goes
    """

    now_s: float
    counters: LinkCounters | None
    reports: tuple[PeerReport, ...]
    publishers: tuple[PublisherState, ...]
    peers: int | None = None
    peer_ages_s: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    peer_clocks: Mapping[str, ClockOffset] = field(default_factory=lambda: MappingProxyType({}))
    refused: Mapping[tuple[MessageKind, MessageRefusal], int] = field(default_factory=lambda: MappingProxyType({}))
    answers: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    pending: int = 0
    left_out: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    is_relay_silent: bool = False
    domain: int | None = None
    remote_participants: int = 1
