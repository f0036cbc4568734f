"""Live publishers, each beside its rows of the plan and of the program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.allocation import Binding

if TYPE_CHECKING:
    from arpd.model.allocation import TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.report.snapshot import Snapshot

_OF_THE_LINK = {Binding.LINK, Binding.MINIMUM}


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicRow:
    """One live publisher, with its row of the plan and of the program where it has one.

    Parameters
    ----------
    publisher : its last announcement
    planned : its row of the plan in force
    allocation : the program's answer in this tick
    age_s : time since the announcement (s)
    """

    publisher: PublisherState
    planned: TopicPlan | None
    allocation: TopicAllocation | None
    age_s: float

    @property
    def kept_ratio(self) -> float:
        """The part of its source's rate that the link leaves the topic now; 1 where the link does not slow it."""
        source_hz, allocation = self.publisher.source_rate_hz, self.allocation
        if self.planned is None or allocation is None or source_hz <= 0 or allocation.binding not in _OF_THE_LINK:
            return 1.0
        return min(1.0, allocation.rate_hz / source_hz)


def topic_rows(snapshot: Snapshot) -> tuple[TopicRow, ...]:
    """Return a row per live publisher, sorted by topic and node; two announcements of one publisher are one row."""
    now_s = snapshot.observation.now_s
    by_identity = {(p.topic, p.node): p for p in snapshot.observation.publishers}
    by_topic = {row.name: row for row in snapshot.allocation.topics}
    plan = snapshot.decision.plan.topics
    return tuple(
        TopicRow(
            publisher=publisher, planned=plan.get(topic), allocation=by_topic.get(topic), age_s=publisher.age_s(now_s)
        )
        for (topic, _node), publisher in sorted(by_identity.items())
    )
