"""Governor: decides when a change that lasts becomes a new plan, so new QoS on the publishers.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.govern.crowd import Crowd, Steady
from arpd.govern.look import Look
from arpd.govern.memory import MemoryWatch
from arpd.govern.patience import Patience
from arpd.govern.plan import make_plan, moves, silent_topics, tightest_requests, with_qos_of
from arpd.govern.swaps import Drift, SwapBudget, usefulness
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION, Decision, QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

_DEMAND_CHANGE = 0.25
_RISE_DWELLS = 3  # shorter deadlines are worth less than longer ones that hold
_NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


class Governor:
    """Decides on plans. Rates follow the price without one, so a plan waits until its change has lasted.

    Parameters
    ----------
    settings : hold, dwell, debounce

    Attributes
    ----------
    plan : in force
    plans_by_cause, refusals_by_reason : number of plans, and of refusals, so far
    """

    def __init__(self, settings: Settings) -> None:
        self.plan = _NO_PLAN
        self.plans_by_cause: Counter[str] = Counter()
        self.refusals_by_reason: Counter[str] = Counter()
        self._settings = settings
        self._demand = Steady()
        self._crowd = Crowd()
        self._sharing = 0  # topics on the link that the plan was made for, under the uniform policy
        self._planned_for: dict[str, tuple[float, float]] = {}  # wanted Hz, and bytes of a sample
        self._changed_at_s = -math.inf
        self._took_over_s = -math.inf
        self._reload_pending = False
        self._drift = Drift()
        self._patience = Patience()
        self._budget = SwapBudget()
        self._owed: frozenset[str] = frozenset()  # topics whose swaps were over the budget
        self._memory = MemoryWatch()
        self._refusals: list[str] = []  # of the last look

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
        participants: int = 1,
    ) -> Decision:
        """Decide on a plan at this tick.

        Parameters
        ----------
        rates : division of the budget of this tick; its price gives every publisher its rate
        lasting : division of the budget that holds most of the time; its periods become deadlines
        participants : processes across the link, which hear of each swap
        """
        announced = max((publisher.generation for publisher in publishers), default=0)
        look = Look(
            now_s=now_s,
            lasting=lasting,
            topics=topics,
            publishers=publishers,
            requests=tightest_requests(publishers),
            silent=silent_topics(publishers),
            newest=min(MOST_GENERATION, announced),
            participants=participants,
        )
        cause = self._look(look, state)
        return Decision(
            gate=_admitted(rates, topics),
            price=rates.price,
            plan=self.plan,
            level_changed=bool(cause),
            reason=cause,
            refusals=tuple(self._refusals),
        )

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self.plan, self._crowd, self._sharing = _NO_PLAN, Crowd(), 0
        self._drift, self._owed = Drift(), frozenset()
        return Decision(gate=1.0, plan=self.plan, level_changed=False, reason="")

    def _look(self, look: Look, state: LinkState) -> str:
        """Make a plan if one is due; return its cause, empty without one."""
        known = frozenset(self._refusals)  # a refusal that lasts counts once
        self._refusals = []
        if look.lasting.topics:
            self._budget.fill(look.now_s, look.lasting.capacity_bytes_per_second)
        cause, now_s = "", look.now_s
        if self._memory.calls_for_depths(
            now_s, look.lasting, look.topics, self.plan, depths=look.depths, silent=look.silent
        ):
            cause = "memory"
            self._follow_memory(look)
        elif look.lasting.topics and state is LinkState.OUTAGE:
            # A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._drift, self._demand = Drift(), Steady()
        elif look.lasting.topics:
            self._note_drift(look)
            if cause := self._cause(look) or self._takeover(look):
                cause = self._plan(look, cause)
        if self._owed and "budget" not in self._refusals:
            self._refusals.append("budget")
        self.refusals_by_reason.update(reason for reason in self._refusals if reason not in known)
        return cause

    def _generation(self, look: Look) -> int:
        return min(MOST_GENERATION, max(look.newest, self.plan.generation) + 1)

    def _follow_memory(self, look: Look) -> None:
        """Give the plan in force the depths that memory allows; the link has not changed.

        Neither the swap budget nor an outage delays this: histories fill in an outage.
        """
        given, before = look.depths(), self.plan.topics
        rows = {
            name: row if name in look.silent else replace(row, depth=given.get(name, row.depth))
            for name, row in before.items()
        }
        self._budget.spend(look.costs(), (name for name, row in rows.items() if row.qos != before[name].qos))
        self.plan = replace(self.plan, generation=self._generation(look), topics=rows)
        self.plans_by_cause["memory"] += 1
        self._memory.note_depths(look.now_s, look.lasting)

    def _note_drift(self, look: Look) -> None:
        """Note which rows in force are not what the lasting budget gives; while all are, the level follows it."""
        found = moves(
            look.lasting,
            look.topics,
            self.plan.topics,
            requests=look.requests,
            silent=look.silent,
            settings=self._settings,
            may_deepen=not self._memory.is_short,
        )
        self._drift.note(look.now_s, found)
        level = look.lasting.capacity_bytes_per_second
        if self.plan.generation > 0 and not self._drift and level != self.plan.level_bytes_per_second:
            self.plan = replace(self.plan, level_bytes_per_second=level)

    def _ripe(self, now_s: float) -> frozenset[str]:
        """Return the topics whose QoS should change, and has long been due."""
        g = self._settings.governor
        tighten_s = self._patience.factor * max(g.hold_s, _RISE_DWELLS * g.dwell_s)
        return self._drift.ripe(now_s, relax_s=g.hold_s, tighten_s=tighten_s, owed=self._owed)

    def _cause(self, look: Look) -> str:
        """Return the cause of a plan that is due, empty if none is."""
        g, now_s = self._settings.governor, look.now_s
        names, sharing = look.crowd
        if names != self.plan.topics.keys() or (sharing != self._sharing and not self._reload_pending):
            if not self._crowd.is_settled(now_s, (names, sharing), debounce_s=g.debounce_s, dwell_s=g.dwell_s):
                return ""  # so a node with ten topics costs one plan
            if self.plan.generation == 0:
                return "start"
            if self._crowd.may_follow(now_s):
                return "topics"
        else:
            self._crowd.note_planned()
        if self._reload_pending:
            return "reload"
        # A reader that requests a shorter deadline than the plan offers is disconnected.
        if not all(keeps_its_readers(row, look.requests.get(name, 0)) for name, row in self.plan.topics.items()):
            return "readers"
        return self._lasting_cause(look)

    def _lasting_cause(self, look: Look) -> str:
        """Return ``down``, ``up`` or ``demand`` when that has lasted, ``budget`` when only swaps that are owed follow.

        Demand alone does not wait for the dwell: until its plan the publishers compute wrong rates.
        """
        g, now_s = self._settings.governor, look.now_s
        has_demand = bool(self._demand_moved(look))
        if self._demand.lasts_s(has_demand, now_s) >= g.hold_s and has_demand:
            return "demand"
        if now_s - self._changed_at_s < g.dwell_s or not (ripe := self._ripe(now_s)):
            return ""
        if ripe <= self._owed:
            return "budget" if self._budget.is_full else ""
        if not self._budget.has_room:
            self._refusals.append("budget")
            return ""
        return "down" if any(self._drift.is_relaxing(name) for name in ripe - self._owed) else "up"

    def _demand_moved(self, look: Look) -> frozenset[str]:
        """Return the topics whose source publishes otherwise than when the plan was made; silence is no demand."""
        return frozenset(
            topic.name
            for topic in look.topics
            if topic.name not in look.silent
            and (planned := self._planned_for.get(topic.name)) is not None
            and (_differ(planned[0], topic.desired_rate_hz) or _differ(planned[1], topic.wire_bytes))
        )

    def _note_demand(self, look: Look) -> None:
        """Note what a new plan was made for; a silent source has the terms of the time when it published."""
        self._planned_for = {
            topic.name: self._planned_for.get(topic.name, (0.0, 0.0)) if topic.name in look.silent else _demand(topic)
            for topic in look.topics
        }

    def _takeover(self, look: Look) -> str:
        """Return ``takeover`` when endpoints have a newer plan of a daemon that left or stepped back.

        They refuse older plans. The dwell bounds how often invented generations cause a plan.
        """
        if not 0 < self.plan.generation < look.newest:
            return ""
        if look.now_s - self._took_over_s < self._settings.governor.dwell_s:
            self._refusals.append("dwell")
            return ""
        self._took_over_s = look.now_s
        return "takeover"

    def _plan(self, look: Look, cause: str) -> str:
        """Make a plan and put it into force; return its cause, empty when the rows in force fit the link as it is now.

        Terms go out at once. New QoS waits for the budget of swaps, but not where a reader would be lost.
        """
        now_s, before, g = look.now_s, self.plan.topics, self._settings.governor
        plan = make_plan(
            look.lasting,
            look.topics,
            look.publishers,
            # After a restart the rows of the predecessor count as the previous plan.
            previous={**_rows_in_force(p for p in look.publishers if p.generation > 0), **before},
            generation=self._generation(look),
            settings=self._settings,
        )
        rows = self._within_budget(look, plan.topics, eager=self._eager(look, cause))
        self._demand, self._sharing = Steady(), look.sharing
        if rows == before and cause in {"down", "up", "budget"}:
            return ""
        if rows.keys() != before.keys():
            self._crowd.note_plan(now_s, debounce_s=g.debounce_s, dwell_s=g.dwell_s)
        self.plan = replace(plan, topics=rows)
        self._changed_at_s = now_s
        self._reload_pending = False
        self.plans_by_cause[cause] += 1
        if cause == "down":
            self._patience.note_fall(now_s)
        elif cause == "up":
            self._patience.note_rise(now_s)
        self._memory.note_plan(look.lasting)
        self._note_demand(look)
        return cause

    def _eager(self, look: Look, cause: str) -> frozenset[str]:
        """Return the topics whose QoS should change with this plan, as far as the budget allows.

        Others keep theirs until their change has lasted; only what promises too much changes with any plan.
        """
        names = frozenset(topic.name for topic in look.topics)
        if cause == "reload":
            return names
        new = names - self.plan.topics.keys() - look.silent  # a silent source gives QoS no basis
        relaxing = frozenset(name for name in names if self._drift.is_relaxing(name))
        return new | relaxing | self._ripe(look.now_s) | self._demand_moved(look)

    def _within_budget(
        self, look: Look, wanted: Mapping[str, TopicPlan], *, eager: Collection[str]
    ) -> dict[str, TopicPlan]:
        """Return the rows to put into force; where a swap must wait, with the QoS of now. The most useful go first."""
        in_force = {**_rows_in_force(look.publishers), **self.plan.topics}
        changed = {name for name, row in wanted.items() if name in in_force and in_force[name].qos != row.qos}
        urgent = {name for name in changed if not keeps_its_readers(in_force[name], look.requests.get(name, 0))}
        costs = look.costs()
        self._budget.spend(costs, urgent)
        ready = changed.intersection(eager) - urgent
        uses = {name: usefulness(in_force[name], wanted[name]) for name in ready}
        if look.sharing and self._budget.has_room:
            self._budget.spend(costs, ready)  # topics that are all alike swap together
            uses = {}
        self._owed = self._budget.choose(costs, uses)
        held = changed - urgent - (ready - self._owed)
        return {
            name: with_qos_of(row, in_force[name], look.requests.get(name, 0)) if name in held else row
            for name, row in wanted.items()
        }


def _admitted(rates: Allocation, topics: Sequence[Topic]) -> float:
    """Return the part of the traffic above the floors that the price admits; 1 where there is none."""
    wanted = sum(topic.wire_bytes * max(0.0, topic.desired_rate_hz - topic.min_rate_hz) for topic in topics)
    pairs = zip(rates.topics, topics, strict=True)
    admitted = sum(topic.wire_bytes * max(0.0, row.rate_hz - topic.min_rate_hz) for row, topic in pairs)
    return min(1.0, admitted / wanted) if wanted > 0 else 1.0


def _differ(before: float, now: float) -> bool:
    return abs(before - now) > _DEMAND_CHANGE * max(before, now)


def _demand(topic: Topic) -> tuple[float, float]:
    return topic.desired_rate_hz, topic.wire_bytes


def _rows_in_force(publishers: Iterable[PublisherState]) -> dict[str, TopicPlan]:
    """Return the rows that publishers announce."""
    return {
        publisher.topic: TopicPlan(
            rate_hz=publisher.rate_hz,
            min_rate_hz=0.0,
            deadline_ns=publisher.deadline_ns,
            depth=max(1, publisher.depth),
        )
        for publisher in publishers
    }
