"""Plan for all topics, made from an allocation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.model.allocation import Allocation, Binding, Topic, TopicAllocation
from arpd.model.plan import QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

# A topic that gets its desired rate is paced above its source, so jitter and a little growth are not throttled. More
# growth is a change of demand, and causes a new plan.
_SOURCE_MARGIN = 1.25
_SPARED_SHARE = 0.05  # of the link
_MOST_FLOORS = 0.5  # of the plan; the gate can always take away the other half


def make_plan(
    allocation: Allocation,
    topics: Sequence[Topic],
    publishers: Iterable[PublisherState],
    *,
    previous: QosPlan,
    generation: int,
    settings: Settings,
) -> QosPlan:
    """Plan for all topics; a row that changes less than the deadband keeps its QoS, so it is not swapped.

    A silent source keeps its row: it costs nothing now, and finds its QoS when it returns.
    """
    publishers = tuple(publishers)
    requested = tightest_requests(publishers)
    silent = {p.topic for p in publishers} - {p.topic for p in publishers if p.source_rate_hz > 0}
    spared = _spared(allocation)
    rows: dict[str, TopicPlan] = {}
    for row, topic in zip(allocation.topics, topics, strict=True):
        fresh = _row(row, topic, requested.get(topic.name, 0), settings)
        if topic.name in spared:
            fresh = replace(fresh, min_rate_hz=fresh.rate_hz)
        if topic.name in silent:
            # Its period is unknown, so a deadline would have no basis.
            fresh = replace(fresh, deadline_ns=requested.get(topic.name, 0))
        kept = previous.topics.get(topic.name)
        if kept is not None and keeps_its_readers(kept, requested.get(topic.name, 0)):
            is_near = topic.name in silent or _within(kept, fresh, settings.governor.deadband)
            if is_near:
                # A floor costs no swap, so it follows the allocation.
                fresh = replace(kept, min_rate_hz=min(fresh.min_rate_hz, kept.rate_hz))
        rows[topic.name] = fresh
    _leave_room(rows, allocation)
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=allocation.capacity_bytes_per_second)


def _leave_room(rows: dict[str, TopicPlan], allocation: Allocation) -> None:
    """Lower floors that leave the gate too little to take away: it must be able to drain a queue."""
    floors = sum(rows[row.name].min_rate_hz / row.max_rate_hz for row in allocation.topics if row.max_rate_hz > 0)
    planned = sum(row.share for row in allocation.topics)
    if floors > _MOST_FLOORS * planned > 0:
        part = _MOST_FLOORS * planned / floors
        for row in allocation.topics:
            rows[row.name] = replace(rows[row.name], min_rate_hz=part * rows[row.name].min_rate_hz)


def _row(row: TopicAllocation, topic: Topic, requested_deadline_ns: int, settings: Settings) -> TopicPlan:
    """Return the row of one topic under an allocation.

    The offered period is slack / R, so jitter is not a missed deadline. It is never longer than a reader requests: such
    a reader would disconnect silently (docs/design.md, DDS facts).
    """
    rate_hz = row.rate_hz
    if row.binding is Binding.DESIRED_RATE:
        most_hz = settings.topic(topic.name).max_rate_hz
        rate_hz = min(_SOURCE_MARGIN * row.rate_hz, math.inf if most_hz is None else most_hz)
    deadline_ns = math.ceil(row.deadline_ns * settings.program.deadline_slack)
    plan = TopicPlan(
        rate_hz=rate_hz, min_rate_hz=min(topic.min_rate_hz, rate_hz), deadline_ns=deadline_ns, depth=row.depth_applied
    )
    return plan if keeps_its_readers(plan, requested_deadline_ns) else replace(plan, deadline_ns=requested_deadline_ns)


def _spared(allocation: Allocation) -> frozenset[str]:
    """Return the smallest topics, together 5 % of the link at most: gating them would free nothing."""
    spared: list[str] = []
    together = 0.0
    for row in sorted(allocation.topics, key=lambda row: (row.share, row.name)):
        together += row.share
        if together > _SPARED_SHARE or row.binding is not Binding.DESIRED_RATE:
            break
        spared.append(row.name)
    return frozenset(spared)


def tightest_requests(publishers: Iterable[PublisherState]) -> dict[str, int]:
    """Return the tightest deadline that readers request, for every topic with such a reader (ns)."""
    tightest: dict[str, int] = {}
    for publisher in publishers:
        if requested_ns := publisher.requested_deadline_ns:
            tightest[publisher.topic] = min(requested_ns, tightest.get(publisher.topic, requested_ns))
    return tightest


def _within(kept: TopicPlan, fresh: TopicPlan, deadband: float) -> bool:
    def near(old: float, new: float) -> bool:
        return old == new or abs(new - old) <= deadband * max(old, new)

    # For a small depth one sample more or less is inside the band.
    same_depth = near(kept.depth, fresh.depth) or abs(kept.depth - fresh.depth) <= 1
    return near(kept.rate_hz, fresh.rate_hz) and same_depth and near(kept.deadline_ns, fresh.deadline_ns)
