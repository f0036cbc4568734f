"""The document of ``/api/v1/history``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from arpd.model.link import LinkState
from arpd.report.decision_log import MOST_EVENTS
from arpd.report.history import MOST_TOPICS, NO_RATES, PERIOD_S, RATE_SERIES, SPAN_S
from arpd.web.api.part import API_VERSION, Amount, Count, Event, Part, Ratio, with_topics

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from arpd.report import events
    from arpd.report.history import Sample


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

    api_version: Literal["v1"] = API_VERSION
    """Version of this document; other versions may lack keys."""
    unix_time_seconds: float | None
    """Wall clock of the last sample (Unix time, s); null before the first."""
    period_seconds: float = PERIOD_S
    """Time between two samples, except for late ticks (s)."""
    span_seconds: float = SPAN_S
    """Age up to which samples are kept (s)."""
    times: Annotated[list[float], Field(max_length=round(SPAN_S / PERIOD_S))]
    """Time of each sample (Unix time, s), counted back from the last one, so that it always rises."""
    link: Link
    gate: list[Ratio | None]
    """Allowed part of the traffic above the minimum rates, 0 to 1."""
    topics: Annotated[list[Topic], Field(max_length=MOST_TOPICS, default=[])]
    """Publishers of the last ten minutes, sorted by topic and node."""
    topics_omitted: Count
    """Live publishers without history, which is kept for 200."""
    events: Annotated[list[Event], Field(max_length=MOST_EVENTS)]
    """The last lines of the decision log, oldest first."""


def history_json(samples: Sequence[Sample], logged: Sequence[events.Event]) -> Iterator[bytes]:
    """Yield the history as a JSON document, topic by topic.

    Parameters
    ----------
    samples : oldest first
    logged : events of the decision log, oldest first
    """
    newest = samples[-1] if samples else None
    link: dict[str, Any] = {
        name: [getattr(sample.link, name) for sample in samples] for name in (*Link.model_fields, "gate")
    }
    head = History.model_construct(
        unix_time_seconds=newest and newest.unix_time_s,
        # Counted back from the newest: somebody may have set the wall clock, and charts need rising times.
        times=[round(newest.unix_time_s - (newest.at_s - sample.at_s), 3) for sample in samples] if newest else [],
        gate=link.pop("gate"),
        link=Link.model_construct(**link),
        topics_omitted=newest.omitted if newest else 0,
        events=[Event.model_validate(event) for event in logged],
    )
    return with_topics(head, _topics(samples))


def _topics(samples: Sequence[Sample]) -> Iterator[Topic]:
    """Yield the topics; numbers come checked from `arpd.report.history`, and JSON says NaN and infinity as null."""
    width = len(RATE_SERIES)
    slots_of_all = {id(sample.slots): sample.slots for sample in reversed(samples)}.values()  # they change rarely
    identities = dict.fromkeys(identity for slots in slots_of_all for identity in slots)
    for identity in sorted([*identities][:MOST_TOPICS]):
        own = (sample.slots.get(identity) for sample in samples)
        rows = [
            NO_RATES if slot is None else sample.rates_hz[slot * width : (slot + 1) * width]
            for sample, slot in zip(samples, own, strict=True)
        ]
        series: dict[str, Any] = {name: [row[number] for row in rows] for number, name in enumerate(RATE_SERIES)}
        yield Topic.model_construct(topic=identity.topic, node=identity.node, **series)
