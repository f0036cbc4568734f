"""From an allocation to a plan, and from a plan to the ordered steps that bring the publishers there."""

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

# A topic that gets all it wants is paced above its source, so that jitter and a little growth are not throttled;
# more growth than that is a change of demand, and a matter for the next plan.
_SOURCE_MARGIN = 1.25
_SPARED_SHARE = 0.05
_MOST_FLOORS = 0.5  # of what is planned: the gate can always take away the other half


def make_plan(
    allocation: Allocation,
    topics: Sequence[Topic],
    publishers: Iterable[PublisherState],
    *,
    previous: QosPlan,
    generation: int,
    settings: Settings,
) -> QosPlan:
    """Plan for all topics; a row that changes less than the deadband keeps its QoS, so that it is not swapped.

    A source that has fallen silent keeps its row: it costs nothing now, and must find its QoS when it returns.
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
            # Nobody knows its period: a deadline would be a promise without a basis.
            fresh = replace(fresh, deadline_ns=requested.get(topic.name, 0))
        kept = previous.topics.get(topic.name)
        if kept is not None and keeps_its_readers(kept, requested.get(topic.name, 0)):
            is_near = topic.name in silent or _within(kept, fresh, settings.governor.deadband)
            if is_near:
                # A floor costs no swap: it follows what the link gives.
                fresh = replace(kept, min_rate_hz=min(fresh.min_rate_hz, kept.rate_hz))
        rows[topic.name] = fresh
    _leave_room(rows, allocation)
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=allocation.capacity_bytes_per_second)


def _leave_room(rows: dict[str, TopicPlan], allocation: Allocation) -> None:
    """Lower floors that would leave the gate nothing to take away: a queue that no gate can drain stands for ever."""
    floors = sum(rows[row.name].min_rate_hz / row.max_rate_hz for row in allocation.topics if row.max_rate_hz > 0)
    planned = sum(row.share for row in allocation.topics)
    if floors > _MOST_FLOORS * planned > 0:
        part = _MOST_FLOORS * planned / floors
        for row in allocation.topics:
            rows[row.name] = replace(rows[row.name], min_rate_hz=part * rows[row.name].min_rate_hz)


def _row(row: TopicAllocation, topic: Topic, requested_deadline_ns: int, settings: Settings) -> TopicPlan:
    """QoS of one topic under an allocation.

    The offered period is slack / R, so that jitter is not a missed deadline, and never longer than what a reader
    requests: such a reader would silently disconnect (docs/design.md, DDS facts).
    """
    rate_hz = row.rate_hz
    if row.binding is Binding.DESIRED_RATE:
        most_hz = settings.topic(topic.name).max_rate_hz
        rate_hz = min(_SOURCE_MARGIN * row.rate_hz, math.inf if most_hz is None else most_hz)
    deadline_ns = math.ceil(row.deadline_ns * settings.program.deadline_slack)
    plan = TopicPlan(
        rate_hz=rate_hz,
        min_rate_hz=min(topic.min_rate_hz, rate_hz),
        deadline_ns=deadline_ns,
        depth=row.depth_applied,
    )
    return plan if keeps_its_readers(plan, requested_deadline_ns) else replace(plan, deadline_ns=requested_deadline_ns)


def _spared(allocation: Allocation) -> frozenset[str]:
    """Return the smallest topics, together a few per cent of the link: gating them would free nothing."""
    spared: list[str] = []
    together = 0.0
    for row in sorted(allocation.topics, key=lambda row: (row.share, row.name)):
        together += row.share
        if together > _SPARED_SHARE or row.binding is not Binding.DESIRED_RATE:
            break
        spared.append(row.name)
    return frozenset(spared)


def tightest_requests(publishers: Iterable[PublisherState]) -> dict[str, int]:
    """Return the tightest deadline readers request, per topic where one does (ns)."""
    tightest: dict[str, int] = {}
    for publisher in publishers:
        if publisher.requested_deadline_ns:
            known = tightest.get(publisher.topic, publisher.requested_deadline_ns)
            tightest[publisher.topic] = min(known, publisher.requested_deadline_ns)
    return tightest


def _within(kept: TopicPlan, fresh: TopicPlan, deadband: float) -> bool:
    def near(old: float, new: float) -> bool:
        return old == new or abs(new - old) <= deadband * max(old, new)

    # One sample more or less is inside the band of a small depth.
    same_depth = near(kept.depth, fresh.depth) or abs(kept.depth - fresh.depth) <= 1
    return near(kept.rate_hz, fresh.rate_hz) and same_depth and near(kept.deadline_ns, fresh.deadline_ns)
