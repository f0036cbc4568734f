"""From live publishers to the rows of the program: what every topic costs and wants."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model import Direction, Topic
from arpd.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model import MemoryState, PublisherState
    from arpd.settings import ProgramSettings, Settings

_LEAST_BUDGET_BYTES = 2.0**20


def topics_to_plan(publishers: Iterable[PublisherState], settings: Settings) -> tuple[Topic, ...]:
    """Return one row per topic that crosses the link and has been seen to publish, sorted by name.

    Several publishers of one topic share its row: the row costs what all of them put on the link.
    """
    by_topic: dict[str, list[PublisherState]] = {}
    for publisher in publishers:
        if publisher.direction is not Direction.LOCAL and publisher.payload_bytes > 0:
            by_topic.setdefault(publisher.topic, []).append(publisher)
    return tuple(_topic(name, by_topic[name], settings) for name in sorted(by_topic))


def memory_budget_bytes(memory: MemoryState, settings: ProgramSettings) -> float:
    """M of (G2): the configured budget, less when the host runs short (bytes)."""
    spare = memory.available_bytes - settings.memory_reserve_bytes
    return max(_LEAST_BUDGET_BYTES, min(settings.memory_budget_bytes, spare))


def _topic(name: str, publishers: list[PublisherState], settings: Settings) -> Topic:
    wishes = settings.topic(name)
    payload_bytes = max(publisher.payload_bytes for publisher in publishers)
    copies = sum(max(1, publisher.remote_readers) for publisher in publishers)
    size, packets = wire_size(payload_bytes)
    source_hz = max(publisher.source_rate_hz for publisher in publishers)
    desired_hz = source_hz if wishes.max_rate_hz is None else min(source_hz, wishes.max_rate_hz)
    # A topic never asks for a floor above what its source publishes.
    floor_hz = min(wishes.min_rate_hz, desired_hz) if desired_hz > 0 else wishes.min_rate_hz
    return Topic(
        name=name,
        wire_bytes=size * copies,
        packets=packets * copies,
        desired_rate_hz=max(desired_hz, floor_hz),
        min_rate_hz=floor_hz,
        weight=wishes.weight,
        min_depth=wishes.min_depth,
        max_depth=wishes.max_depth,
        latency_budget_s=wishes.latency_budget_s,
        # Measured on Fast DDS 2.14 (shared/SWAP.md): 0.7 kB a slot and about 1.3 times the payload.
        slot_bytes=700.0 + 1.3 * payload_bytes,
    )
