"""Rows of the program, from live publishers or from what the configuration assumes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.allocation import Topic
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.settings import Policy, ProgramSettings, Settings
from arpd.model.wire import FRAGMENT_BYTES, SMALL_PACKETS, wire_size

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.observation import MemoryState

_LEAST_BUDGET_BYTES = 2.0**20
_COMMAND_HZ = 20.0  # least floor of a small topic to the robot: a late command is dangerous


@dataclass(frozen=True, kw_only=True, slots=True)
class Traffic:
    """Load that the publishers of one topic put on the link.

    Parameters
    ----------
    topic : topic name
    payload_bytes : serialized size of a sample, > 0 (bytes)
    source_rate_hz : rate at which the application publishes, 0 = silent (Hz)
    copies : times that each sample crosses the link: once per remote reader of each publisher
    parts : payload (bytes), rate (Hz) and copies of each publisher; empty = there is one
    is_command : whether it goes to the robot
    """

    topic: str
    payload_bytes: float
    source_rate_hz: float
    copies: int = 1
    parts: tuple[tuple[float, float, int], ...] = ()
    is_command: bool = False


def rows_of_traffic(traffic: Iterable[Traffic], settings: Settings) -> tuple[Topic, ...]:
    """Return one row of the program per topic, sorted by name."""
    return tuple(_row(each, settings) for each in sorted(traffic, key=lambda each: each.topic))


def measured_traffic(publishers: Iterable[PublisherState]) -> tuple[Traffic, ...]:
    """Return the traffic of topics that cross the link and have published, all publishers of a topic together."""
    by_topic: dict[str, list[PublisherState]] = {}
    for publisher in publishers:
        if publisher.direction is not Direction.LOCAL and publisher.payload_bytes > 0:
            by_topic.setdefault(publisher.topic, []).append(publisher)
    return tuple(
        Traffic(
            topic=name,
            payload_bytes=max(publisher.payload_bytes for publisher in publishers),
            source_rate_hz=max(publisher.source_rate_hz for publisher in publishers),
            copies=sum(publisher.copies for publisher in publishers),
            parts=tuple((each.payload_bytes, each.source_rate_hz, each.copies) for each in publishers),
            is_command=all(publisher.direction is Direction.ACTUATION for publisher in publishers),
        )
        for name, publishers in by_topic.items()
    )


def assumed_traffic(settings: Settings) -> tuple[Traffic, ...]:
    """Return the traffic that the configuration assumes, with one remote reader per topic."""
    return tuple(
        Traffic(topic=topic.name, payload_bytes=topic.payload_bytes, source_rate_hz=topic.source_rate_hz)
        for topic in settings.topics
        if topic.payload_bytes is not None and topic.source_rate_hz is not None
    )


def memory_budget_bytes(memory: MemoryState, settings: ProgramSettings) -> float:
    """Return M of (G2): the configured budget, less when the host runs short of memory (bytes)."""
    spare = memory.available_bytes - settings.memory_reserve_bytes
    return max(_LEAST_BUDGET_BYTES, min(settings.memory_budget_bytes, spare))


def _row(traffic: Traffic, settings: Settings) -> Topic:
    preferences = settings.topic(traffic.topic)
    source_hz = traffic.source_rate_hz
    desired_hz = source_hz if preferences.max_rate_hz is None else min(source_hz, preferences.max_rate_hz)
    # One picture of 0.9 MB a second is more than a link of 5 Mbit/s carries: nobody asked for that floor. Eq. (4) does.
    is_asked = traffic.payload_bytes <= SMALL_PACKETS * FRAGMENT_BYTES or settings.program.policy is Policy.UNIFORM
    own_hz, default_hz = preferences.min_rate_hz, settings.defaults.min_rate_hz
    if traffic.is_command and settings.program.policy is Policy.PER_TOPIC:
        default_hz = max(default_hz, _COMMAND_HZ)
    desired_hz = desired_hz or (default_hz if own_hz is None else own_hz)
    # A floor never exceeds what the source publishes.
    floor_hz = min((default_hz if is_asked else 0.0) if own_hz is None else own_hz, desired_hz)
    wire_bytes, packets = _wire_size(traffic, desired_hz)
    return Topic(
        name=traffic.topic,
        wire_bytes=wire_bytes,
        packets=packets,
        desired_rate_hz=desired_hz,
        min_rate_hz=floor_hz,
        weight=preferences.weight,
        min_depth=preferences.min_depth,
        max_depth=preferences.max_depth,
        latency_budget_s=preferences.latency_budget_s,
        # Measured on Fast DDS 2.14 (docs/design.md, DDS facts): 0.7 kB a slot and about 1.3 times the payload.
        slot_bytes=700.0 + 1.3 * traffic.payload_bytes,
    )


def _wire_size(traffic: Traffic, rate_hz: float) -> tuple[float, int]:
    """Return bytes and packets on the link for a sample of the fastest publisher, with what the others send meanwhile.

    At a lower rate fewer samples share a heartbeat, and a slow publisher is thinned later; the headroom covers that.
    """
    is_silent, wire_bytes, packets = traffic.source_rate_hz == 0.0, 0.0, 0.0
    for payload_bytes, source_hz, copies in traffic.parts or ((traffic.payload_bytes, rate_hz, traffic.copies),):
        share = 1.0 if is_silent else min(1.0, source_hz / rate_hz)
        size, count = wire_size(payload_bytes, rate_hz=share * rate_hz)
        wire_bytes += share * copies * size
        packets += share * copies * count
    return wire_bytes, max(1, round(packets))
