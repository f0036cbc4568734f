"""What a plan wants of live AdaptiveSubscriptions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.plan import QosPlan, ReaderPlan, ReaderPlans, TopicPlan

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import ReaderState

# The deadline a reader requests is this much longer than the one its writer offers: compatible whatever is rounded,
# and late only when the link is, for the offer has slack of its own.
_REQUEST_MARGIN = 1.5


def plan_readers(readers: Iterable[ReaderState], plan: QosPlan) -> ReaderPlans:
    """Return what a plan wants of the readers of its topics."""
    return {
        (reader.node, reader.topic): _row(reader, row)
        for reader in readers
        if reader.is_driven and (row := plan.topics.get(reader.topic)) is not None
    }


def restore_readers(readers: Iterable[ReaderState]) -> ReaderPlans:
    """Return every reader that carries a plan to the QoS its application asked for."""
    return {
        (reader.node, reader.topic): ReaderPlan(depth=reader.baseline_depth, deadline_ns=reader.baseline_deadline_ns)
        for reader in readers
        if reader.is_driven and reader.generation > 0
    }


def _row(reader: ReaderState, row: TopicPlan) -> ReaderPlan:
    """QoS of one reader: deep as its writer, its deadline a margin longer than the one offered.

    Where the application asks for no deadline it gets none: a request would only shut out writers that offer none,
    such as its own publisher's when that restarts while no daemon is there to plan for it.
    """
    is_asked_for = reader.baseline_deadline_ns > 0
    return ReaderPlan(
        depth=reader.depth if reader.keeps_all else row.depth,
        deadline_ns=math.ceil(_REQUEST_MARGIN * row.deadline_ns) if is_asked_for else 0,
    )


def is_reader_confirmed(reader: ReaderState, row: ReaderPlan) -> bool:
    """Whether an announcement shows the row in force."""
    return (reader.keeps_all or reader.depth == row.depth) and reader.deadline_ns == row.deadline_ns
