"""Offline plans: the daemon's program and planner for a link of a given capacity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.govern.plan import make_plan
from arpd.model.plan import NANOSECONDS_PER_SECOND
from arpd.solve.program import Program
from arpd.solve.topics import rows_of_traffic

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.allocation import Allocation, Topic, TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.model.settings import Settings
    from arpd.solve.topics import Traffic


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedTopic:
    """One topic: its traffic, its row, its allocation, and the QoS that its publisher would offer."""

    traffic: Traffic
    topic: Topic
    allocation: TopicAllocation
    qos: TopicPlan

    @property
    def rate_hz(self) -> float:
        """Rate after rounding to whole nanoseconds of period, 0 = paused (Hz)."""
        period_ns = self.allocation.deadline_ns
        return NANOSECONDS_PER_SECOND / period_ns if period_ns else 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class OfflinePlan:
    """Plan for one capacity.

    Parameters
    ----------
    capacity_bytes_per_second : capacity for these topics, before headroom (bytes/s)
    topics : one entry per topic, sorted by name
    allocation : whole answer of the program
    """

    capacity_bytes_per_second: float
    topics: tuple[PlannedTopic, ...]
    allocation: Allocation

    @property
    def link_share(self) -> float:
        """Share of link time that all topics take together (dimensionless)."""
        return sum(row.allocation.share for row in self.topics)

    @property
    def memory_bytes(self) -> float:
        """Memory that all full histories take together (bytes)."""
        return sum(row.topic.slot_bytes * row.qos.depth for row in self.topics)


class OfflinePlanner:
    """Plans the same topics for any number of capacities.

    Parameters
    ----------
    settings : the configuration
    traffic : load of the topics to plan for
    publishers : the measured ones among them, for the deadlines that their readers request
    crossing : topics that cross the link, managed or not, as far as known
    """

    def __init__(
        self,
        settings: Settings,
        traffic: Iterable[Traffic],
        *,
        publishers: Iterable[PublisherState] = (),
        crossing: int = 0,
    ) -> None:
        self._settings = settings
        self._traffic = sorted(traffic, key=lambda each: each.topic)
        self._publishers = tuple(publishers)
        self._crossing = crossing
        self._topics = rows_of_traffic(self._traffic, settings)
        self._program = Program(settings)

    def plan(self, capacity_bytes_per_second: float) -> OfflinePlan:
        """Return the daemon's first plan for a link of this capacity, before headroom, ≥ 0 (bytes/s)."""
        budget_bytes = self._settings.program.memory_budget_bytes
        allocation = self._program.solve(capacity_bytes_per_second, self._topics, budget_bytes, crossing=self._crossing)
        plan = make_plan(allocation, self._topics, self._publishers, previous={}, generation=1, settings=self._settings)
        topics = tuple(
            PlannedTopic(traffic=traffic, topic=topic, allocation=row, qos=plan.topics[topic.name])
            for traffic, topic, row in zip(self._traffic, self._topics, allocation.topics, strict=True)
        )
        return OfflinePlan(capacity_bytes_per_second=capacity_bytes_per_second, topics=topics, allocation=allocation)
