"""Live publishers, each beside its rows of the plan and of the program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.model.allocation import TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.report.snapshot import Snapshot


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicRow:
    """One live publisher, with its row of the plan and of the program where it has one.

    Parameters
    ----------
    publisher : its last announcement
    planned : its row of the plan in force
    allocation : the program's answer in this tick
    """

    publisher: PublisherState
    planned: TopicPlan | None
    allocation: TopicAllocation | None


def topic_rows(snapshot: Snapshot) -> tuple[TopicRow, ...]:
    """Return a row per live publisher, sorted by topic and node; two announcements of one publisher are one row."""
    by_identity = {(p.topic, p.node): p for p in snapshot.observation.publishers}
    by_topic = {row.name: row for row in snapshot.allocation.topics}
    plan = snapshot.decision.plan.topics
    return tuple(
        TopicRow(publisher=publisher, planned=plan.get(topic), allocation=by_topic.get(topic))
        for (topic, _node), publisher in sorted(by_identity.items())
    )
