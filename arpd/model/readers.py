"""Live AdaptiveSubscriptions, and what a plan wants of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.refusal import RefusalReason

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from arpd.model.values import QosPlan, TopicPlan

# The deadline a reader requests is this much longer than the one its writer offers: compatible whatever is rounded,
# and late only when the link is, for the offer has slack of its own.
_REQUEST_MARGIN = 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderState:
    """What one AdaptiveSubscription announced, joined with what the graph says of its topic.

    Parameters
    ----------
    node, topic : fully qualified names, together the reader's identity
    depth, deadline_ns : in force; ``deadline_ns`` is the requested period, 0 = infinite (samples, ns)
    baseline_depth, baseline_deadline_ns : the application's own, to be restored on a clean stop
    generation : generation of the plan last asked for, 0 = the application's own
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    keeps_all : whether its history is KEEP_ALL, so that a depth means nothing
    refusal, refusal_reason : why the last request was refused, or any would be, in words and by name
    handovers_by_result : handovers since start, by result
    requests_ns : periods its node's readers of the topic request in the graph; two while one replaces the other
    offers_ns : periods the topic's writers offer in the graph, 0 = infinite
    deadlines_missed : requested deadlines the middleware counted as missed, over all readers so far
    age_s : time since the announcement (s)
    """

    node: str
    topic: str
    depth: int
    deadline_ns: int = 0
    baseline_depth: int
    baseline_deadline_ns: int = 0
    generation: int = 0
    lease_s: float = 0.0
    keeps_all: bool = False
    refusal: str = ""
    refusal_reason: RefusalReason = RefusalReason.NONE
    handovers_by_result: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    requests_ns: tuple[int, ...] = ()
    offers_ns: tuple[int, ...] = ()
    deadlines_missed: int = 0
    age_s: float = 0.0

    @property
    def is_driven(self) -> bool:
        """Whether arpd may change it; otherwise its request binds writers as any other reader's does."""
        return not self.refusal_reason.is_lasting


@dataclass(frozen=True, kw_only=True, slots=True)
class ReaderPlan:
    """QoS of one reader under a plan: depth (samples) and requested deadline period (ns, 0 = infinite)."""

    depth: int
    deadline_ns: int


ReaderPlans = dict[tuple[str, str], ReaderPlan]  # by node and topic


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
