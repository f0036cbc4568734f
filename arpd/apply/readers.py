"""Rows of a plan for live AdaptiveSubscriptions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.plan import QosPlan, ReaderPlan, ReaderPlans, TopicPlan

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.endpoints import ReaderState

# A reader requests a deadline this much longer than the one its writer offers. So rounding cannot make them
# incompatible, and the deadline is missed only when the link is late: the offer has slack of its own.
_REQUEST_MARGIN = 1.5


def plan_readers(readers: Iterable[ReaderState], plan: QosPlan) -> ReaderPlans:
    """Return the rows for the readers of a plan's topics."""
    return {
        (reader.node, reader.topic): _row(reader, row)
        for reader in readers
        if reader.is_driven and (row := plan.topics.get(reader.topic)) is not None
    }


def restore_readers(readers: Iterable[ReaderState]) -> ReaderPlans:
    """Return the rows that give every reader that carries a plan its application's QoS back."""
    return {
        (reader.node, reader.topic): ReaderPlan(depth=reader.baseline_depth, deadline_ns=reader.baseline_deadline_ns)
        for reader in readers
        if reader.is_driven and reader.generation > 0
    }


def _row(reader: ReaderState, row: TopicPlan) -> ReaderPlan:
    """Return the row of one reader: the depth of its writer, and a deadline longer than the offered one.

    A reader whose application requests no deadline gets none. A request would only shut out writers that offer none,
    such as a publisher that restarts while no daemon plans for it.
    """
    requests_deadline = reader.baseline_deadline_ns > 0
    return ReaderPlan(
        depth=reader.depth if reader.keeps_all else row.depth,
        deadline_ns=math.ceil(_REQUEST_MARGIN * row.deadline_ns) if requests_deadline else 0,
    )


def is_reader_confirmed(reader: ReaderState, row: ReaderPlan) -> bool:
    """Return whether an announcement shows the row in force."""
    return (reader.keeps_all or reader.depth == row.depth) and reader.deadline_ns == row.deadline_ns
