"""Governor: decides when a change that lasts becomes a new plan, so new QoS on the publishers.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.govern.memory import MemoryWatch
from arpd.govern.plan import make_plan, silent_topics, tightest_requests, with_qos_of
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION, Decision, QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

_DEMAND_CHANGE = 0.25
_RISE_DWELLS = 3  # shorter deadlines are worth less than longer ones that hold
_MINUTE_S = 60.0
_NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


class _Steady:
    """Time for which a value has stayed the same."""

    def __init__(self) -> None:
        self._value: object = None
        self._since_s = -math.inf

    def lasts_s(self, value: object, now_s: float) -> float:
        """Return for how long it has been this value (s)."""
        if value != self._value:
            self._value, self._since_s = value, now_s
        return now_s - self._since_s


class Governor:
    """Decides on plans. Rates follow the price without one, so a plan waits until its change has lasted.

    Parameters
    ----------
    settings : thresholds, dwell, deadband, budget

    Attributes
    ----------
    plan : in force
    levels_by_cause, refusals_by_reason : number of plans, and of refusals, so far
    """

    def __init__(self, settings: Settings) -> None:
        self.plan = _NO_PLAN
        self.levels_by_cause: Counter[str] = Counter()
        self.refusals_by_reason: Counter[str] = Counter()
        self._settings = settings
        self._crowd, self._moved, self._demand = _Steady(), _Steady(), _Steady()
        self._sharing = 0  # topics on the link that the plan was made for, under the uniform policy
        self._planned_for: dict[str, tuple[float, float]] = {}  # wanted Hz, and bytes of a sample
        self._changed_at_s = -math.inf
        self._took_over_s = -math.inf
        self._reload_pending = False
        self._owed = False  # swaps that were over the budget
        self._memory = MemoryWatch()
        self._swapped: deque[float] = deque()  # times
        self._refused: frozenset[str] = frozenset()  # at the last tick: a refusal that lasts counts once

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
        generation = min(MOST_GENERATION, max(newest, self.plan.generation) + 1)
        requests, silent = tightest_requests(publishers), silent_topics(publishers)
        cause, refusals = "", list[str]()
        if self._memory.calls_for_depths(now_s, lasting, topics, self.plan, silent=silent):
            cause = "memory"
            self._follow_memory(now_s, lasting, generation, silent)
        elif lasting.topics and state is LinkState.OUTAGE and self.plan.generation > 0:
            # A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._moved, self._demand = _Steady(), _Steady()
        elif lasting.topics:
            cause = self._cause(now_s, lasting, topics, requests, silent) or self._takeover(now_s, newest, refusals)
        if cause and cause != "memory":
            # After a restart the rows of the predecessor count as the previous plan.
            previous = {**_inherited(publishers), **self.plan.topics}
            plan = make_plan(
                lasting, topics, publishers, previous=previous, generation=generation, settings=self._settings
            )
            self._sharing = _sharing(lasting)
            cause = self._adopt(now_s, cause, plan, requests, refusals)
            if cause:
                self._memory.note_plan(lasting)
                self._note_demand(topics, silent)
        self.refusals_by_reason.update(reason for reason in refusals if reason not in self._refused)
        self._refused = frozenset(refusals)
        return Decision(
            gate=_admitted(rates, topics),
            price=rates.price,
            plan=self.plan,
            level_changed=bool(cause),
            reason=cause,
            refusals=tuple(refusals),
        )

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self.plan, self._crowd, self._sharing = _NO_PLAN, _Steady(), 0
        return Decision(gate=1.0, plan=self.plan, level_changed=False, reason="")

    def _follow_memory(self, now_s: float, allocation: Allocation, generation: int, silent: Collection[str]) -> None:
        """Give the plan in force the depths that memory allows; the link has not changed.

        Neither the swap budget nor an outage delays this: histories fill in an outage.
        """
        given = {row.name: row.depth_applied for row in allocation.topics if row.name not in silent}
        before = self.plan.topics
        rows = {name: replace(row, depth=given.get(name, row.depth)) for name, row in before.items()}
        self._swapped.extend(now_s for name, row in rows.items() if row.qos != before[name].qos)
        self.plan = replace(self.plan, generation=generation, topics=rows)
        self.levels_by_cause["memory"] += 1
        self._memory.note_depths(now_s, allocation)

    def _cause(
        self,
        now_s: float,
        lasting: Allocation,
        topics: Sequence[Topic],
        requests: Mapping[str, int],
        silent: Collection[str],
    ) -> str:
        """Return the cause of a plan that is due, empty if none is."""
        names, sharing = frozenset(row.name for row in lasting.topics), _sharing(lasting)
        unchanged_s = self._crowd.lasts_s((names, sharing), now_s)
        if names != self.plan.topics.keys() or (sharing != self._sharing and not self._reload_pending):
            if unchanged_s < self._settings.governor.debounce_s:
                return ""  # so a node with ten topics costs one plan
            return "topics" if self.plan.generation > 0 else "start"
        if self._reload_pending:
            return "reload"
        # A reader that requests a shorter deadline than the plan offers is disconnected.
        if not all(keeps_its_readers(row, requests.get(name, 0)) for name, row in self.plan.topics.items()):
            return "readers"
        return self._level_cause(now_s, lasting, topics, silent)

    def _level_cause(self, now_s: float, lasting: Allocation, topics: Sequence[Topic], silent: Collection[str]) -> str:
        """Return ``down``, ``up`` or ``demand`` when that has lasted, ``budget`` when swaps that are owed may follow.

        Demand alone does not wait for the dwell: until its plan the publishers compute wrong rates.
        """
        g = self._settings.governor
        level, now = self.plan.level_bytes_per_second, lasting.capacity_bytes_per_second
        moved = "down" if now < g.down_ratio * level else "up" if now > g.up_ratio * level else ""
        moved_s = self._moved.lasts_s(moved, now_s)
        has_demand = self._demand_moved(topics, silent)
        if self._demand.lasts_s(has_demand, now_s) >= g.hold_s and has_demand:
            return "demand"
        if now_s - self._changed_at_s < (_RISE_DWELLS * g.dwell_s if moved == "up" else g.dwell_s):
            return ""
        if moved and moved_s >= g.hold_s:
            return moved
        return "budget" if self._owed and self._swaps_left(now_s) > 0 else ""

    def _demand_moved(self, topics: Sequence[Topic], silent: Collection[str]) -> bool:
        """Return whether a source publishes otherwise than when the plan was made; silence is no demand."""
        return any(
            abs(before - now) > _DEMAND_CHANGE * max(before, now)
            for topic in topics
            if topic.name not in silent
            for before, now in zip(self._planned_for[topic.name], _demand(topic), strict=True)
        )

    def _note_demand(self, topics: Sequence[Topic], silent: Collection[str]) -> None:
        """Note what a new plan was made for; a silent source has the terms of the time when it published."""
        self._planned_for = {
            topic.name: self._planned_for.get(topic.name, (0.0, 0.0)) if topic.name in silent else _demand(topic)
            for topic in topics
        }

    def _takeover(self, now_s: float, newest: int, refusals: list[str]) -> str:
        """Return ``takeover`` when endpoints have a newer plan of a daemon that left or stepped back.

        They refuse older plans. The dwell bounds how often invented generations cause a plan.
        """
        if not 0 < self.plan.generation < newest:
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
        before, rows = self.plan.topics, dict(plan.topics)
        self._moved, self._demand, self._owed = _Steady(), _Steady(), False
        if rows == before and cause in {"down", "up", "budget"}:
            self.plan = replace(self.plan, level_bytes_per_second=plan.level_bytes_per_second)
            return ""
        new = len(rows.keys() - before.keys())  # these never wait: without a plan they have no terms either
        changed = [name for name, row in rows.items() if name in before and before[name].qos != row.qos]
        changed.sort(key=lambda name: -rows[name].weight)
        if late := changed[max(0, self._swaps_left(now_s) - new) :]:
            refusals.append("budget")
            self._owed = True
        for name in late:
            rows[name] = with_qos_of(rows[name], before[name], requests.get(name, 0))
        self._swapped.extend([now_s] * (new + sum(before[name].qos != rows[name].qos for name in changed)))
        self.plan = replace(plan, topics=rows)
        self._changed_at_s = now_s
        self._reload_pending = False
        self.levels_by_cause[cause] += 1
        return cause

    def _swaps_left(self, now_s: float) -> int:
        """Return the swaps that the budget of this minute still allows."""
        while self._swapped and now_s - self._swapped[0] > _MINUTE_S:
            self._swapped.popleft()
        return self._settings.governor.swaps_per_minute - len(self._swapped)


def _sharing(allocation: Allocation) -> int:
    return allocation.uniform.topics if allocation.uniform else 0


def _admitted(rates: Allocation, topics: Sequence[Topic]) -> float:
    """Return the part of the traffic above the floors that the price admits; 1 where there is none."""
    wanted = sum(topic.wire_bytes * max(0.0, topic.desired_rate_hz - topic.min_rate_hz) for topic in topics)
    pairs = zip(rates.topics, topics, strict=True)
    admitted = sum(topic.wire_bytes * max(0.0, row.rate_hz - topic.min_rate_hz) for row, topic in pairs)
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
