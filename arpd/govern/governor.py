"""Governor: decides when a change that lasts becomes a new plan, so new QoS on the publishers.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.govern.classes import Move
from arpd.govern.crowd import Crowd
from arpd.govern.plan import depths, rows_and_moves, silent_topics, tightest_requests, with_qos_of
from arpd.govern.swaps import SwapBudget, swap_costs
from arpd.model.allocation import Binding, Decision
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION, QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

_DEMAND_CHANGE = 0.25
_RISE_DWELLS = 3  # shorter deadlines and deeper histories are worth less than ones that hold
# When a fall follows a rise so soon, the next rise waits twice as long, up to so many times: topics on a link that
# swings settle at what always fits.
_RELAPSE_S, _MOST_PATIENCE = 120.0, 16
_EXCESS = 0.1  # of the memory that histories under the plan may take; less is not worth swaps
_NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


class _Look:
    """What a plan would be made for now.

    Attributes
    ----------
    requests : tightest deadline that readers request, by topic (ns)
    silent : topics that nobody publishes on
    in_force : row of every topic, of the plan or as announced
    wanted : row of every topic that the program would give it
    moves : where QoS under the plan should go; a topic that is missing is where it should be
    """

    def __init__(
        self,
        now_s: float,
        *,
        lasting: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
        participants: int,
        planned: Mapping[str, TopicPlan],
        settings: Settings,
    ) -> None:
        self.now_s, self.lasting, self.topics = now_s, lasting, topics
        self.publishers, self.participants = publishers, participants
        self.requests, self.silent = tightest_requests(publishers), silent_topics(publishers)
        others = [publisher for publisher in publishers if publisher.topic not in planned]
        self.in_force = {**_rows_in_force(others), **planned}
        # After a restart the rows of the predecessor count as the previous plan.
        previous = {**_rows_in_force(other for other in others if other.generation > 0), **planned}
        self.wanted, moves = rows_and_moves(lasting, topics, publishers, previous=previous, settings=settings)
        self.moves = {name: move for name, move in moves.items() if name in planned}

    @property
    def sharing(self) -> int:
        """Number of topics that share the link under the uniform policy, 0 under the other."""
        return self.lasting.uniform.topics if self.lasting.uniform else 0

    @property
    def newest(self) -> int:
        """Newest generation that any endpoint announces."""
        return min(MOST_GENERATION, max((publisher.generation for publisher in self.publishers), default=0))


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
        self.plans_by_cause: Counter[str] = Counter()
        self.refusals_by_reason: Counter[str] = Counter()
        self._settings = settings
        self._swaps = SwapBudget()
        self._reload_pending = False
        self._changed_at_s = self._took_over_s = -math.inf
        self._refusals: frozenset[str] = frozenset()  # of the last look
        self._planned_for: dict[str, tuple[float, float]] = {}  # wanted Hz, and bytes of a sample
        self._begin()

    def _begin(self) -> None:
        self.plan = _NO_PLAN
        self._crowd = Crowd()
        self._sharing = 0  # topics on the link that the plan was made for, under the uniform policy
        self._moving: dict[str, tuple[Move, float]] = {}  # where QoS should go, and since when (s)
        self._demand_since_s = math.inf
        self._patience, self._rose_at_s = 1, -math.inf
        self._owed: frozenset[str] = frozenset()  # topics whose swaps were over the budget

    def reconfigure(self, settings: Settings) -> None:
        """Take new settings; a new plan follows at the next tick."""
        self._settings = settings
        self._reload_pending = True

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self._begin()
        return Decision(allowed=1.0, plan=self.plan, level_changed=False, reason="")

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
        known, self._refusals = self._refusals, frozenset()  # a refusal that lasts counts once
        cause = ""
        if lasting.topics:
            look = _Look(
                now_s,
                lasting=lasting,
                topics=topics,
                publishers=publishers,
                participants=participants,
                planned=self.plan.topics,
                settings=self._settings,
            )
            self._swaps.fill(now_s, lasting.capacity_bytes_per_second)
            cause = self._follow_memory(look) or self._follow(look, state)
            if self._owed:
                self._refuse("budget")
        self.refusals_by_reason.update(self._refusals - known)
        return Decision(
            allowed=_allowed(rates, topics),
            price=rates.price,
            plan=self.plan,
            level_changed=bool(cause),
            reason=cause,
            refusals=tuple(sorted(self._refusals)),
        )

    def _follow_memory(self, look: _Look) -> str:
        """Take depths that the memory of now allows; return ``memory``, or nothing where those in force do.

        A robot that runs out of memory waits for nothing: no hold, no budget of swaps, and no end of an outage.
        """
        if all(row.depth_binding is not Binding.MEMORY for row in look.lasting.topics):
            return ""
        given, slots = depths(look.lasting, look.topics), {topic.name: topic.slot_bytes for topic in look.topics}
        rows = {
            name: row if name in look.silent else replace(row, depth=min(row.depth, given.get(name, row.depth)))
            for name, row in self.plan.topics.items()
        }
        taken = sum(slots[name] * row.depth for name, row in self.plan.topics.items() if name in slots)
        less = sum(slots[name] * row.depth for name, row in rows.items() if name in slots)
        if less >= (1.0 - _EXCESS) * taken:
            return ""
        changed = (name for name, row in rows.items() if row.qos != self.plan.topics[name].qos)
        self._swaps.spend(self._costs(look), changed)
        self._take(look, rows, "memory")
        return "memory"

    def _follow(self, look: _Look, state: LinkState) -> str:
        """Make a plan if one is due; return its cause, empty without one."""
        if state is LinkState.OUTAGE:
            # A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._moving, self._demand_since_s = {}, math.inf
            return ""
        self._note_moves(look)
        cause = self._cause(look) or self._takeover(look)
        return self._plan(look, cause) if cause else ""

    def _note_moves(self, look: _Look) -> None:
        """Note since when QoS has not been what the program gives; while all is, the level follows."""
        start = (Move.NONE, look.now_s)
        self._moving = {
            name: before if (before := self._moving.get(name, start))[0] is move else (move, look.now_s)
            for name, move in look.moves.items()
        }
        self._owed = self._owed.intersection(self._moving)  # not where a source fell silent, or its QoS fits again
        level = look.lasting.capacity_bytes_per_second
        if self.plan.generation > 0 and not self._moving and level != self.plan.level_bytes_per_second:
            self.plan = replace(self.plan, level_bytes_per_second=level)
        has_demand = self._has_new_demand(look)
        self._demand_since_s = min(self._demand_since_s, look.now_s) if has_demand else math.inf

    def _ripe(self, now_s: float) -> frozenset[str]:
        """Return the topics whose QoS should change, and has long been due."""
        g = self._settings.governor
        lasts_s = {Move.RELAX: g.hold_s, Move.TIGHTEN: self._patience * max(g.hold_s, _RISE_DWELLS * g.dwell_s)}
        return frozenset(
            name
            for name, (move, since_s) in self._moving.items()
            if name in self._owed or now_s - since_s >= lasts_s[move]
        )

    def _cause(self, look: _Look) -> str:
        """Return the cause of a plan that is due, empty if none is."""
        g, now_s, names = self._settings.governor, look.now_s, look.wanted.keys()
        if names != self.plan.topics.keys() or (look.sharing != self._sharing and not self._reload_pending):
            if self._crowd.is_settled(now_s, (frozenset(names), look.sharing), g.debounce_s, g.dwell_s):
                return "topics" if self.plan.generation else "start"
            if not self.plan.generation:
                return ""
        else:
            self._crowd.note_same()
        if self._reload_pending:
            return "reload"
        # A reader that requests a shorter deadline than the plan offers is disconnected.
        if not all(keeps_its_readers(row, look.requests.get(name, 0)) for name, row in self.plan.topics.items()):
            return "readers"
        return self._lasting_cause(look)

    def _lasting_cause(self, look: _Look) -> str:
        """Return ``down``, ``up`` or ``demand`` when that has lasted, ``budget`` when only swaps that are owed follow.

        Demand alone does not wait for the dwell: until its plan the publishers compute wrong rates.
        """
        g, now_s = self._settings.governor, look.now_s
        if now_s - self._demand_since_s >= g.hold_s:
            return "demand"
        if now_s - self._changed_at_s < g.dwell_s or not (ripe := self._ripe(now_s)):
            return ""
        if ripe <= self._owed:
            return "budget" if self._swaps.is_full else ""
        if not self._swaps.has_room:
            self._refuse("budget")
            return ""
        return "down" if any(self._moving[name][0] is Move.RELAX for name in ripe - self._owed) else "up"

    def _has_new_demand(self, look: _Look) -> bool:
        """Return whether a source publishes otherwise than when the plan was made; silence is no demand."""
        return any(
            (planned := self._planned_for.get(topic.name)) is not None
            and (_differ(planned[0], topic.desired_rate_hz) or _differ(planned[1], topic.wire_bytes))
            for topic in look.topics
            if topic.name not in look.silent
        )

    def _takeover(self, look: _Look) -> str:
        """Return ``takeover`` when endpoints have a newer plan of a daemon that left or stepped back.

        They refuse older plans. The dwell bounds how often invented generations cause a plan.
        """
        if not 0 < self.plan.generation < look.newest:
            return ""
        if look.now_s - self._took_over_s < self._settings.governor.dwell_s:
            self._refuse("dwell")
            return ""
        self._took_over_s = look.now_s
        return "takeover"

    def _plan(self, look: _Look, cause: str) -> str:
        """Make a plan and put it into force; return its cause, empty when the rows in force fit the link as it is now.

        Terms go out at once. New QoS waits for the budget of swaps, but not where a reader would be lost.
        """
        rows = self._within_budget(look)
        if rows == self.plan.topics and cause in {"down", "up", "budget"}:
            return ""
        if rows.keys() != self.plan.topics.keys():
            self._crowd.note_plan(look.now_s)
        self._take(look, rows, cause)
        self._changed_at_s, self._reload_pending, self._sharing = look.now_s, False, look.sharing
        self._demand_since_s = math.inf
        if cause == "up":
            self._rose_at_s = look.now_s
        elif cause == "down" and self._rose_at_s > -math.inf:
            has_relapsed = look.now_s - self._rose_at_s < _RELAPSE_S
            self._patience = min(_MOST_PATIENCE, 2 * self._patience) if has_relapsed else 1
            self._rose_at_s = -math.inf
        # A silent source has the terms of the time when it published.
        self._planned_for = {
            topic.name: self._planned_for.get(topic.name, (0.0, 0.0)) if topic.name in look.silent else _demand(topic)
            for topic in look.topics
        }
        return cause

    def _take(self, look: _Look, rows: Mapping[str, TopicPlan], cause: str) -> None:
        level = self.plan.level_bytes_per_second if cause == "memory" else look.lasting.capacity_bytes_per_second
        generation = min(MOST_GENERATION, max(look.newest, self.plan.generation) + 1)
        self.plan = QosPlan(generation=generation, topics=rows, level_bytes_per_second=level)
        self.plans_by_cause[cause] += 1

    def _within_budget(self, look: _Look) -> dict[str, TopicPlan]:
        """Return the rows to put into force; where a swap must wait, with the QoS of now. The heaviest go first."""
        wanted, in_force, costs = look.wanted, look.in_force, self._costs(look)
        changed = {name for name, row in wanted.items() if name in in_force and in_force[name].qos != row.qos}
        urgent = {name for name in changed if not keeps_its_readers(in_force[name], look.requests.get(name, 0))}
        self._swaps.spend(costs, urgent)
        # A silent source gives QoS no basis.
        ready = sorted(changed - urgent - look.silent, key=lambda name: (wanted[name].weight, name))
        waiting = list(ready)
        if look.sharing and self._swaps.has_room:
            self._swaps.spend(costs, waiting)  # topics that are all alike swap together
            waiting.clear()
        while waiting and self._swaps.has_room:
            self._swaps.spend(costs, (waiting.pop(),))
        self._owed = frozenset(waiting)
        held = changed - urgent - (frozenset(ready) - self._owed)
        return {
            name: with_qos_of(row, in_force[name], look.requests.get(name, 0)) if name in held else row
            for name, row in wanted.items()
        }

    def _costs(self, look: _Look) -> dict[str, float]:
        return swap_costs(look.publishers, participants=look.participants)

    def _refuse(self, reason: str) -> None:
        self._refusals |= {reason}


def _allowed(rates: Allocation, topics: Sequence[Topic]) -> float:
    """Return the part of the traffic above the floors that the price allows; 1 where there is none."""
    wanted = sum(topic.wire_bytes * max(0.0, topic.desired_rate_hz - topic.min_rate_hz) for topic in topics)
    pairs = zip(rates.topics, topics, strict=True)
    allowed = sum(topic.wire_bytes * max(0.0, row.rate_hz - topic.min_rate_hz) for row, topic in pairs)
    return min(1.0, allowed / wanted) if wanted > 0 else 1.0


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
