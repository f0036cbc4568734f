"""Ordered steps that bring publishers to a plan, and the plan that restores them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.plan import QosPlan, TopicPlan, Transition

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import PublisherState, ReaderState


def is_confirmed(publisher: PublisherState, row: TopicPlan) -> bool:
    """Return whether an announcement shows the row in force; announced rates have six digits.

    A publisher that refuses new QoS for good is confirmed by its rate: it is paced and gated, and takes no more.
    """
    if not (publisher.rate_hz == row.rate_hz or math.isclose(publisher.rate_hz, row.rate_hz, rel_tol=1e-4)):
        return False
    if publisher.refusal_reason.is_lasting:
        return True
    same_depth = publisher.keeps_all or publisher.depth == row.depth
    return same_depth and publisher.deadline_ns == row.deadline_ns


def publisher_transitions(
    due: Iterable[tuple[PublisherState, TopicPlan]], *, generation: int, reason: str, lease_s: float
) -> tuple[Transition, ...]:
    """Return one step per node that brings these publishers to these rows; nodes that free link time come first.

    Invariant: any prefix of the steps leaves every publisher in its old or its new row, and puts no more on the link
    than the larger of the two plans.
    """
    wanted: dict[str, dict[str, TopicPlan]] = {}
    change_hz: dict[str, float] = {}
    for publisher, row in due:
        wanted.setdefault(publisher.node, {})[publisher.topic] = row
        now_hz = min(publisher.rate_hz, publisher.source_rate_hz)
        cost = (min(row.rate_hz, publisher.source_rate_hz) - now_hz) * publisher.payload_bytes
        change_hz[publisher.node] = change_hz.get(publisher.node, 0.0) + cost
    return tuple(
        Transition(node=node, generation=generation, topics=wanted[node], reason=reason, lease_s=lease_s)
        for node in sorted(wanted, key=lambda name: (change_hz[name], name))
    )


def has_lease(endpoint: PublisherState | ReaderState, lease_s: float) -> bool:
    """Return whether an endpoint announces the lease; announced times have six digits."""
    return math.isclose(endpoint.lease_s, lease_s, rel_tol=1e-4)


def restore_plan(publishers: Iterable[PublisherState], *, generation: int) -> QosPlan:
    """Return the plan that gives every publisher its application's QoS back, unpaced."""
    rows = {publisher.topic: _own_qos(publisher, rate_hz=math.inf) for publisher in publishers}
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=0.0)


def paced_restore_plan(publishers: Iterable[PublisherState], *, generation: int) -> QosPlan:
    """Return the plan that gives every publisher its application's QoS back, at the rate it has now."""
    rows = {publisher.topic: _own_qos(publisher, rate_hz=publisher.rate_hz) for publisher in publishers}
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=0.0)


def _own_qos(publisher: PublisherState, *, rate_hz: float) -> TopicPlan:
    return TopicPlan(
        rate_hz=rate_hz,
        min_rate_hz=0.0,
        deadline_ns=publisher.baseline_deadline_ns,
        depth=publisher.baseline_depth,
    )
