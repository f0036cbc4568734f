"""Proof that a plan is in force, and the plan that restores publishers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.plan import QosPlan, TopicPlan

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import PublisherState


def is_confirmed(publisher: PublisherState, row: TopicPlan) -> bool:
    """Return whether an announcement shows the row in force; announced rates have six digits.

    A publisher that refuses new QoS for good is confirmed by its ceiling: it is paced, and takes no more.
    """
    if not (publisher.rate_hz == row.rate_hz or math.isclose(publisher.rate_hz, row.rate_hz, rel_tol=1e-4)):
        return False
    if publisher.refusal_reason.is_lasting:
        return True
    same_depth = publisher.keeps_all or publisher.depth == row.depth
    return same_depth and publisher.deadline_ns == row.deadline_ns


def has_lease(publisher: PublisherState, lease_s: float) -> bool:
    """Return whether a publisher announces the lease; announced times have six digits."""
    return math.isclose(publisher.lease_s, lease_s, rel_tol=1e-4)


def restore_plan(publishers: Iterable[PublisherState], *, generation: int) -> QosPlan:
    """Return the plan that gives every publisher its application's QoS back, unpaced."""
    rows = {publisher.topic: _own_qos(publisher, rate_hz=math.inf) for publisher in publishers}
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=0.0)


def paced_restore_plan(publishers: Iterable[PublisherState], *, generation: int) -> QosPlan:
    """Return the plan that gives every publisher its application's QoS back, at the rate it has now."""
    rows = {publisher.topic: _own_qos(publisher, rate_hz=publisher.paced_rate_hz) for publisher in publishers}
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=0.0)


def _own_qos(publisher: PublisherState, *, rate_hz: float) -> TopicPlan:
    return TopicPlan(
        rate_hz=rate_hz,
        min_rate_hz=0.0,
        deadline_ns=publisher.baseline_deadline_ns,
        depth=publisher.baseline_depth,
    )
