"""The document of ``/api/v1/history``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from arpd.model.link import LinkState
from arpd.report.decision_log import MOST_EVENTS
from arpd.report.history import MOST_TOPICS, PERIOD_S, SPAN_S
from arpd.web.api.part import Amount, Count, Event, Part, Ratio


class Link(Part):
    """Estimates of the link."""

    capacity_bytes_per_second: list[Amount | None]
    """Capacity of the whole link (bytes/s on the wire)."""
    available_bytes_per_second: list[Amount | None]
    """Capacity left for arpd's topics (bytes/s on the wire)."""
    budget_bytes_per_second: list[Amount | None]
    """What the topics may use (bytes/s)."""
    level_bytes_per_second: list[Amount | None]
    """Lasting budget that the plan in force was made for (bytes/s)."""
    delivery_rate_bytes_per_second: list[Amount | None]
    """Rate at which the peer received bytes (bytes/s on the wire)."""
    foreign_bytes_per_second: list[Amount | None]
    """Cross traffic (bytes/s on the wire)."""
    queue_delay_seconds: list[Amount | None]
    """One-way delay from robot to peer above its minimum (s)."""
    loss_ratio: list[Ratio | None]
    """Share of probe packets that never arrived."""
    state: list[LinkState]
    """State of the link."""


class Topic(Part):
    """One publisher."""

    topic: str
    """Topic name; topic and node identify the publisher."""
    node: str
    """Fully qualified node name."""
    planned_rate_hz: list[Amount | None]
    """Ceiling of the plan (Hz); null = unpaced or not planned."""
    published_rate_hz: list[Amount | None]
    """Rate at which the writer sent samples (Hz)."""
    source_rate_hz: list[Amount | None]
    """Rate at which the application called publish() (Hz)."""
    paced_rate_hz: list[Amount | None]
    """Rate that the price leaves the publisher (Hz); null = unpaced or not there."""


class History(Part):
    """The answer of GET /api/v1/history: the last ten minutes, one sample a second, in columns as long as times.

    The oldest sample comes first; null = nothing or unknown. Numbers have five digits. Within v1 new keys may come and
    none goes.
    """

    api_version: Literal["v1"]
    """Version of this document; other versions may lack keys."""
    unix_time_seconds: float | None
    """Wall clock of the last sample (Unix time, s); null before the first."""
    period_seconds: float
    """Time between two samples, except for late ticks (s)."""
    span_seconds: float
    """Age up to which samples are kept (s)."""
    times: Annotated[list[float], Field(max_length=round(SPAN_S / PERIOD_S))]
    """Time of each sample (Unix time, s), counted back from the last one, so that it always rises."""
    link: Link
    gate: list[Ratio | None]
    """Part of the traffic above the floors that is admitted, 0 to 1."""
    topics: Annotated[list[Topic], Field(max_length=MOST_TOPICS)]
    """Publishers of the last ten minutes, sorted by topic and node."""
    topics_omitted: Count
    """Live publishers without history, which is kept for 200."""
    events: Annotated[list[Event], Field(max_length=MOST_EVENTS)]
    """The last lines of the decision log, oldest first."""
