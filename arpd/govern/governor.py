"""Governor: decides when a change that lasts becomes a new plan, so new QoS on the publishers.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from arpd.govern.memory import MemoryWatch
from arpd.govern.plan import make_plan, silent_topics, tightest_requests, with_qos_of
from arpd.model.allocation import Allocation, AllocationStatus, Topic
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION, Decision, QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

_DEMAND_CHANGE = 0.25
_RISE_DWELLS = 3  # shorter deadlines are worth less than longer ones that hold
_MINUTE_S = 60.0
_NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


class _Crowd(NamedTuple):
    """What a plan is made for: its topics, and under the uniform policy how many share the link."""

    names: frozenset[str] = frozenset()
    sharing: int = 0


class Governor:
    """Decides on plans. Rates follow the price without one, so a plan waits until its change has lasted.

    Parameters
    ----------
    settings : thresholds, dwell, deadband, budget
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._plan = _NO_PLAN
        self._moved, self._moved_since_s = "", -math.inf  # where the lasting budget is, seen from the plan's
        self._demand_since_s: float | None = None
        self._topics = self._seen = _Crowd()
        self._planned_for: dict[str, tuple[float, float]] = {}  # wanted Hz, and bytes of a sample
        self._seen_since_s = -math.inf
        self._changed_at_s = -math.inf
        self._took_over_s = -math.inf
        self._reload_pending = False
        self._owed = False  # swaps that were over the budget
        self._memory = MemoryWatch()
        self._swapped: deque[tuple[float, int]] = deque()
        self._levels: Counter[str] = Counter()
        self._refusals: Counter[str] = Counter()
        self._refused: frozenset[str] = frozenset()  # at the last tick: a refusal that lasts counts once

    @property
    def plan(self) -> QosPlan:
        """Plan in force."""
        return self._plan

    @property
    def levels_by_cause(self) -> Mapping[str, int]:
        """Number of plans so far, by cause."""
        return dict(self._levels)

    @property
    def refusals_by_reason(self) -> Mapping[str, int]:
        """Number of refusals so far, by reason."""
        return dict(self._refusals)

    def reconfigure(self, settings: Settings) -> None:
        """Take new settings; a new plan follows at the next tick."""
        self._settings = settings
        self._reload_pending = True

    def decide(
        self,
        now_s: float,
        *,
        state: LinkState,
        rates: Allocation,
        lasting: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
        newest: int = 0,
    ) -> Decision:
        """Decide on a plan at this tick.

        Parameters
        ----------
        rates : division of the budget of this tick; its price gives every publisher its rate
        lasting : division of the budget that holds most of the time; its periods become deadlines
        newest : newest generation that any reader announces
        """
        newest = min(MOST_GENERATION, max([newest, *(publisher.generation for publisher in publishers)]))
        silent = silent_topics(publishers)
        refusals: list[str] = []
        if self._memory.calls_for_depths(now_s, lasting, self._planned(topics), besides=silent):
            cause = "memory"
            self._follow_memory(now_s, lasting, newest, besides=silent)
        else:
            cause = self._cause(now_s, state, lasting, topics, publishers)
            if not cause and lasting.topics and state is not LinkState.OUTAGE:
                cause = self._takeover(now_s, newest, refusals)
            if cause:
                plan = self._next_plan(lasting, topics, publishers, newest)
                cause = self._adopt(now_s, cause, plan, tightest_requests(publishers), refusals)
            if cause:
                self._memory.note_plan(lasting)
                self._note_demand(topics, silent)
        self._refusals.update(reason for reason in refusals if reason not in self._refused)
        self._refused = frozenset(refusals)
        return Decision(
            gate=_admitted(rates, topics),
            price=rates.price,
            plan=self._plan,
            level_changed=bool(cause),
            reason=cause,
            refusals=tuple(refusals),
        )

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self._plan = _NO_PLAN
        self._topics = self._seen = _Crowd()
        return Decision(gate=1.0, plan=self._plan, level_changed=False, reason="", refusals=())

    def _follow_memory(self, now_s: float, allocation: Allocation, newest: int, *, besides: Collection[str]) -> None:
        """Give the plan in force the depths that memory allows; the link has not changed.

        Neither the swap budget nor an outage delays this: histories fill in an outage.
        """
        given = {row.name: row.depth_applied for row in allocation.topics if row.name not in besides}
        rows = {name: replace(row, depth=given.get(name, row.depth)) for name, row in self._plan.topics.items()}
        swaps = sum(self._plan.topics[name].qos != row.qos for name, row in rows.items())
        self._plan = replace(self._plan, generation=self._next_generation(newest), topics=rows)
        self._swapped.append((now_s, swaps))
        self._levels["memory"] += 1
        self._memory.note_depths(now_s, allocation)

    def _cause(
        self,
        now_s: float,
        state: LinkState,
        lasting: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
    ) -> str:
        """Return the cause of a plan that is due, empty if none is."""
        if lasting.status is AllocationStatus.EMPTY:
            return ""
        if state is LinkState.OUTAGE and self._plan.generation > 0:
            # A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._moved, self._demand_since_s = "", None
            return ""
        crowd = _crowd(lasting)
        if crowd.names != self._topics.names or (crowd != self._topics and not self._reload_pending):
            return self._topics_cause(now_s, crowd)
        self._seen = crowd
        if self._reload_pending:
            return "reload"
        if self._loses_readers(publishers):
            return "readers"
        return self._level_cause(now_s, lasting, topics, silent_topics(publishers))

    def _loses_readers(self, publishers: Sequence[PublisherState]) -> bool:
        """Return whether a reader requests a shorter deadline than the plan offers, so it is disconnected."""
        requests = tightest_requests(publishers)
        return any(not keeps_its_readers(row, requests.get(topic, 0)) for topic, row in self._plan.topics.items())

    def _topics_cause(self, now_s: float, crowd: _Crowd) -> str:
        """Debounce topics that come and go, so a node with ten topics costs one plan."""
        if crowd != self._seen:
            self._seen, self._seen_since_s = crowd, now_s
        if now_s - self._seen_since_s < self._settings.governor.debounce_s:
            return ""
        return "start" if self._plan.generation == 0 else "topics"

    def _level_cause(self, now_s: float, lasting: Allocation, topics: Sequence[Topic], silent: Collection[str]) -> str:
        """Return ``down``, ``up`` or ``demand`` when that has lasted, ``budget`` when swaps that are owed may follow.

        Demand alone does not wait for the dwell: until its plan the publishers compute wrong rates.
        """
        g = self._settings.governor
        level, now = self._plan.level_bytes_per_second, lasting.capacity_bytes_per_second
        moved = "down" if now < g.down_ratio * level else "up" if now > g.up_ratio * level else ""
        if moved != self._moved:
            self._moved, self._moved_since_s = moved, now_s
        self._demand_since_s = _since(self._demand_moved(topics, silent), self._demand_since_s, now_s)
        if self._demand_since_s is not None and now_s - self._demand_since_s >= g.hold_s:
            return "demand"
        if now_s - self._changed_at_s < (g.dwell_s if self._moved != "up" else _RISE_DWELLS * g.dwell_s):
            return ""
        if moved and now_s - self._moved_since_s >= g.hold_s:
            return moved
        return "budget" if self._owed and self._swaps_left(now_s) > 0 else ""

    def _planned(self, topics: Sequence[Topic]) -> list[tuple[Topic, TopicPlan]]:
        """Pair every topic in the plan in force with its row."""
        return [(topic, row) for topic in topics if (row := self._plan.topics.get(topic.name)) is not None]

    def _demand_moved(self, topics: Sequence[Topic], silent: Collection[str]) -> bool:
        """Return whether a source publishes otherwise than when the plan was made; silence is no demand."""
        return any(
            abs(before - now) > _DEMAND_CHANGE * max(before, now)
            for topic in topics
            if topic.name not in silent and topic.name in self._planned_for
            for before, now in zip(self._planned_for[topic.name], _demand(topic), strict=True)
        )

    def _note_demand(self, topics: Sequence[Topic], silent: Collection[str]) -> None:
        """Note what a new plan was made for; a silent source has the terms of the time when it published."""
        self._planned_for = {
            topic.name: self._planned_for.get(topic.name, (0.0, 0.0)) if topic.name in silent else _demand(topic)
            for topic in topics
        }

    def _next_plan(
        self, allocation: Allocation, topics: Sequence[Topic], publishers: Sequence[PublisherState], newest: int
    ) -> QosPlan:
        self._topics = _crowd(allocation)
        # After a restart the rows of the predecessor count as the previous plan.
        return make_plan(
            allocation,
            topics,
            publishers,
            previous=replace(self._plan, topics={**_inherited(publishers), **self._plan.topics}),
            generation=self._next_generation(newest),
            settings=self._settings,
        )

    def _next_generation(self, newest: int) -> int:
        return min(MOST_GENERATION, max(newest, self._plan.generation) + 1)

    def _takeover(self, now_s: float, newest: int, refusals: list[str]) -> str:
        """Return ``takeover`` when endpoints have a newer plan of a daemon that left or stepped back.

        They refuse older plans. The dwell bounds how often invented generations cause a plan.
        """
        if not 0 < self._plan.generation < newest:
            return ""
        if now_s - self._took_over_s < self._settings.governor.dwell_s:
            refusals.append("dwell")
            return ""
        self._took_over_s = now_s
        return "takeover"

    def _adopt(self, now_s: float, cause: str, plan: QosPlan, requests: Mapping[str, int], refusals: list[str]) -> str:
        """Put a plan into force, and return its cause; empty when the rows in force fit the link as it is now.

        Topics whose swaps are over the budget keep their QoS, and wait: the heaviest go first.
        """
        before, rows = self._plan.topics, dict(plan.topics)
        self._moved, self._demand_since_s, self._owed = "", None, False
        if rows == before and cause in {"down", "up", "budget"}:
            self._plan = replace(self._plan, level_bytes_per_second=plan.level_bytes_per_second)
            return ""
        new = len(rows.keys() - before.keys())  # these never wait: without a plan they have no terms either
        changed = [name for name, row in rows.items() if name in before and before[name].qos != row.qos]
        changed.sort(key=lambda name: -rows[name].weight)
        if late := changed[max(0, self._swaps_left(now_s) - new) :]:
            refusals.append("budget")
            self._owed = True
        for name in late:
            rows[name] = with_qos_of(rows[name], before[name], requests.get(name, 0))
        self._swapped.append((now_s, new + sum(before[name].qos != rows[name].qos for name in changed)))
        self._plan = replace(plan, topics=rows)
        self._changed_at_s = now_s
        self._reload_pending = False
        self._levels[cause] += 1
        return cause

    def _swaps_left(self, now_s: float) -> int:
        """Return the swaps that the budget of this minute still allows."""
        while self._swapped and now_s - self._swapped[0][0] > _MINUTE_S:
            self._swapped.popleft()
        return self._settings.governor.swaps_per_minute - sum(count for _, count in self._swapped)


def _crowd(allocation: Allocation) -> _Crowd:
    sharing = allocation.uniform.topics if allocation.uniform else 0
    return _Crowd(frozenset(row.name for row in allocation.topics), sharing)


def _admitted(rates: Allocation, topics: Sequence[Topic]) -> float:
    """Return the part of the traffic above the floors that the price admits; 1 where there is none."""
    wanted = admitted = 0.0
    for row, topic in zip(rates.topics, topics, strict=True):
        floor_hz = min(topic.min_rate_hz, row.rate_hz)
        wanted += topic.wire_bytes * max(0.0, topic.desired_rate_hz - topic.min_rate_hz)
        admitted += topic.wire_bytes * (row.rate_hz - floor_hz)
    return min(1.0, admitted / wanted) if wanted > 0 else 1.0


def _demand(topic: Topic) -> tuple[float, float]:
    return topic.desired_rate_hz, topic.wire_bytes


def _inherited(publishers: Sequence[PublisherState]) -> dict[str, TopicPlan]:
    """Return the rows that a predecessor left in force; a restarted daemon keeps QoS that is near enough."""
    return {
        publisher.topic: TopicPlan(
            rate_hz=publisher.rate_hz, min_rate_hz=0.0, deadline_ns=publisher.deadline_ns, depth=publisher.depth
        )
        for publisher in publishers
        if publisher.generation > 0
    }


def _since(holds: bool, since_s: float | None, now_s: float) -> float | None:  # noqa: FBT001 - a condition, not a mode
    """Start, keep or clear the time since which a condition holds."""
    if not holds:
        return None
    return now_s if since_s is None else since_s
