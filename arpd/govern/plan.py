"""Plan for all topics, made from an allocation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.govern.classes import CLASSES, EXACT, LONGEST_DEADLINE_NS, Fit, Ladder, Move
from arpd.model.plan import QosPlan, TopicPlan, keeps_its_readers
from arpd.model.wire import FRAGMENT_BYTES
from arpd.solve.eq4 import alike

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic, TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

# The ceiling is above the source's rate, so jitter and a little growth are not throttled. More growth is a change of
# demand, and causes a new plan.
_SOURCE_MARGIN = 1.25
# Rates and sizes as measured; a row that differs by no more is not sent again.
_NOISE = 0.02
# A timer of Linux wakes up to some milliseconds late, and a reader's clock runs from arrival to arrival: at 200 Hz a
# quarter of the period alone missed 95 deadlines in 20 s on an idle link.
_LEAST_SLACK_NS = 10_000_000


def make_plan(
    allocation: Allocation,
    topics: Sequence[Topic],
    publishers: Sequence[PublisherState],
    *,
    previous: Mapping[str, TopicPlan],
    generation: int,
    settings: Settings,
) -> QosPlan:
    """Plan for all topics; `rows_and_moves` explains the arguments."""
    rows, _ = rows_and_moves(allocation, topics, publishers, previous=previous, settings=settings)
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=allocation.capacity_bytes_per_second)


def rows_and_moves(
    allocation: Allocation,
    topics: Sequence[Topic],
    publishers: Sequence[PublisherState],
    *,
    previous: Mapping[str, TopicPlan],
    settings: Settings,
) -> tuple[dict[str, TopicPlan], dict[str, Move]]:
    """Return a row for each topic, and where its QoS goes, only where it does.

    Depth and deadline come in classes, and a row whose class still fits keeps its writer. The uniform policy has no
    classes: its rows have the exact optimum. A silent source keeps its ceiling and its QoS: it costs nothing now, and
    finds them when it returns.

    Parameters
    ----------
    allocation : answer of the program for the budget that lasts
    previous : rows of the plan before
    """
    requests, silent, ladder = tightest_requests(publishers), silent_topics(publishers), _ladder(allocation)
    large = {publisher.topic for publisher in publishers if publisher.payload_bytes > FRAGMENT_BYTES}
    rows: dict[str, TopicPlan] = {}
    moves: dict[str, Move] = {}
    for row, topic in zip(allocation.topics, topics, strict=True):
        request_ns, kept = requests.get(topic.name, 0), previous.get(topic.name)
        fit = _fit(row, topic, request_ns, slack=settings.program.deadline_slack)
        fresh = _row(fit, topic, ladder)
        if topic.name in silent:
            fresh = _silent(fresh, kept, request_ns, is_large=topic.name in large)
        elif kept is not None:
            fresh = _without_noise(fresh, kept)
            if (move := fit.move(kept, ladder)) is Move.NONE:
                fresh = with_qos_of(fresh, kept, request_ns)
            else:
                moves[topic.name] = move
        if (most_hz := settings.topic(topic.name).max_rate_hz) is not None:
            fresh = replace(fresh, rate_hz=min(fresh.rate_hz, most_hz))
        rows[topic.name] = fresh if allocation.uniform is None else alike(fresh)
    return rows, moves


def depths(allocation: Allocation, topics: Sequence[Topic]) -> dict[str, int]:
    """Return the depths that an allocation gives, in their classes (samples)."""
    ladder = _ladder(allocation)
    return {
        topic.name: _fit(row, topic, 0, slack=1.0).qos(ladder)[0]
        for row, topic in zip(allocation.topics, topics, strict=True)
    }


def silent_topics(publishers: Sequence[PublisherState]) -> frozenset[str]:
    """Return the topics that nobody publishes on now."""
    return frozenset(p.topic for p in publishers) - {p.topic for p in publishers if p.source_rate_hz > 0}


def with_qos_of(row: TopicPlan, kept: TopicPlan, requested_deadline_ns: int) -> TopicPlan:
    """Return a row with the QoS of another one, unless a reader would disconnect."""
    if not keeps_its_readers(kept, requested_deadline_ns):
        return row
    return replace(row, depth=kept.depth, deadline_ns=kept.deadline_ns)


def _silent(row: TopicPlan, kept: TopicPlan | None, requested_deadline_ns: int, *, is_large: bool) -> TopicPlan:
    """Return the row of a silent source: rate and period are unknown, so new ones would have no basis.

    Where no rate was ever known, small samples have no ceiling, and large ones begin slowly, as before a first plan.
    """
    row = replace(row, deadline_ns=requested_deadline_ns)
    if kept is None:
        return row if is_large else replace(row, rate_hz=math.inf)
    row = replace(row, rate_hz=kept.rate_hz)
    if kept.weight > 0 and kept.packets:  # a size includes the heartbeats of a sample, which depend on the rate
        row = replace(row, wire_bytes=kept.wire_bytes, packets=kept.packets)
    return with_qos_of(row, kept, requested_deadline_ns)


def _without_noise(row: TopicPlan, kept: TopicPlan) -> TopicPlan:
    """Return a row with the measured numbers of another one where both differ by noise alone."""
    if math.isclose(row.rate_hz, kept.rate_hz, rel_tol=_NOISE):
        row = replace(row, rate_hz=kept.rate_hz)
    if row.packets == kept.packets and math.isclose(row.wire_bytes, kept.wire_bytes, rel_tol=_NOISE):
        row = replace(row, wire_bytes=kept.wire_bytes)
    return row


def _ladder(allocation: Allocation) -> Ladder:
    return CLASSES if allocation.uniform is None else EXACT


def _row(fit: Fit, topic: Topic, ladder: Ladder) -> TopicPlan:
    """Return the row of one topic under an allocation."""
    depth, deadline_ns = fit.qos(ladder)
    return TopicPlan(
        rate_hz=_SOURCE_MARGIN * topic.desired_rate_hz,
        min_rate_hz=topic.min_rate_hz,
        deadline_ns=deadline_ns,
        depth=depth,
        weight=topic.weight,
        wire_bytes=topic.wire_bytes,
        packets=topic.packets,
    )


def _fit(row: TopicAllocation, topic: Topic, request_ns: int, *, slack: float) -> Fit:
    """Return what an allocation gives a topic: the period of its rate has a slack, so jitter misses no deadline."""
    period_ns = row.deadline_ns
    offered_ns = max(math.ceil(period_ns * slack), period_ns + _LEAST_SLACK_NS) if period_ns else 0
    return Fit(
        period_ns=period_ns,
        offered_ns=min(offered_ns, LONGEST_DEADLINE_NS),
        request_ns=request_ns,
        depth=row.depth_applied,
        least_depth=topic.min_depth,
        most_depth=topic.max_depth,
    )


def tightest_requests(publishers: Sequence[PublisherState]) -> dict[str, int]:
    """Return the tightest deadline that readers request, for every topic with such a reader (ns)."""
    tightest: dict[str, int] = {}
    for publisher in publishers:
        if requested_ns := publisher.requested_deadline_ns:
            tightest[publisher.topic] = min(requested_ns, tightest.get(publisher.topic, requested_ns))
    return tightest
