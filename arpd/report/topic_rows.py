"""Live publishers, each beside its rows of the plan and of the program."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.allocation import Binding, TopicAllocation

if TYPE_CHECKING:
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.report.snapshot import Snapshot

_SLOWED_BELOW = 0.95
_BEHIND_BELOW = 0.7  # rates are of the last five seconds, and of two moments
_OF_THE_LINK = {Binding.LINK, Binding.MINIMUM}


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """One publisher that has announced itself; topic and node identify it.

    Parameters
    ----------
    planned : its row of the plan in force; null if no plan has the topic, or the plan gives it back
    confirmed : what it announces: its counters, and the settings in force
    allocation : what the last tick gives it; null if the program does not have the topic
    kept_ratio : part of the rate it wants that the link leaves it now, 0 to 1; 1 where the link does not slow it
    keeps_qos : True if it refuses new QoS for good, so that arpd manages only the rate
    age_s : time since the announcement (s)
    """

    topic: str
    node: str
    planned: TopicPlan | None
    confirmed: PublisherState
    allocation: TopicAllocation | None
    kept_ratio: float
    keeps_qos: bool
    age_s: float

    @property
    def is_slowed(self) -> bool:
        """Whether the link keeps it below the rate it wants; a rate within a twentieth of that slows nobody."""
        return self.kept_ratio < _SLOWED_BELOW

    @property
    def is_behind(self) -> bool:
        """Whether it leaves far more slowly than its source and the last tick let it; not of one that is silent."""
        is_judged = self.planned is not None and self.allocation is not None
        return is_judged and 0.0 < self.confirmed.published_rate_hz < _BEHIND_BELOW * self.most_hz

    @property
    def most_hz(self) -> float:
        """Rate that its source and the last tick let go (Hz)."""
        return min(self.wanted_hz, self.allowed_hz)

    @property
    def wanted_hz(self) -> float:
        """Rate of its source, or less where the configuration says so (Hz)."""
        return _wanted_hz(self.confirmed, self.planned)

    @property
    def allowed_hz(self) -> float:
        """Rate that the last tick gives it, ``inf`` where the program does not have it (Hz)."""
        return self.allocation.rate_hz if self.allocation else math.inf


def topic_rows(snapshot: Snapshot) -> tuple[Topic, ...]:
    """Return a row per live publisher, sorted by topic and node; two announcements of one publisher are one row."""
    by_identity = {(p.topic, p.node): p for p in snapshot.observation.publishers}
    by_topic = {row.name: row for row in snapshot.allocation.topics}
    rows = []
    for (topic, node), publisher in sorted(by_identity.items()):
        planned, allocation = snapshot.decision.plan.topics.get(topic), by_topic.get(topic)
        kept = 1.0
        if planned and allocation and publisher.source_rate_hz > 0 and allocation.binding in _OF_THE_LINK:
            kept = min(1.0, allocation.rate_hz / _wanted_hz(publisher, planned))
        rows.append(
            Topic(
                topic=topic,
                node=node,
                planned=planned if planned and planned.depth else None,
                confirmed=publisher,
                allocation=allocation,
                kept_ratio=kept,
                keeps_qos=publisher.refusal_reason.is_lasting,
                age_s=publisher.age_s(snapshot.observation.now_s),
            )
        )
    return tuple(rows)


def _wanted_hz(publisher: PublisherState, planned: TopicPlan | None) -> float:
    return min(publisher.source_rate_hz, planned.max_rate_hz if planned else math.inf)
