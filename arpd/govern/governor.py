"""Governor: decides when a change that lasts becomes a new plan, so new QoS on the publishers.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.govern.plan import Move, Wanted, is_confirmed
from arpd.govern.swaps import SwapBudget, swap_costs
from arpd.model.allocation import Allocation, Binding, Decision, Topic
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.link import LinkState
from arpd.model.plan import MOST_GENERATION, QosPlan, TopicPlan, is_kept, own_qos

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from arpd.model.settings import Settings

_DEMAND_CHANGE = 0.25  # a source that grows by more is above the ceiling of its plan
_RISE_DWELLS = 3  # shorter deadlines and deeper histories are worth less than ones that hold
_EXCESS = 0.1  # of the memory that histories under the plan may take; less is not worth swaps


class Governor:
    """Decides on plans. Rates follow the price without one, so a plan waits until its change has lasted.

    Parameters
    ----------
    settings : hold, dwell, debounce

    Attributes
    ----------
    plan : in force
    plans_by_cause : number of plans so far
    """

    def __init__(self, settings: Settings) -> None:
        self.plans_by_cause: Counter[str] = Counter()
        self._settings = settings
        self._swaps = SwapBudget()
        self._reload_pending = False
        self._changed_at_s = -math.inf
        self._is_postponed = False
        self._begin()

    def _begin(self) -> None:
        self.plan = QosPlan()
        self._planned: Mapping[str, TopicPlan] = {}  # rows of the plan, without those of topics given back
        self._given_back: dict[str, TopicPlan] = {}
        self._left: dict[str, tuple[float, TopicPlan]] = {}  # topics to give back: since when (s), and their last terms
        self._crowd: object = None  # topics that there are, and since when they have been the same (s)
        self._same_since_s, self._differs_since_s = -math.inf, math.inf
        self._sharing = 0  # topics on the link that the plan was made for, under the uniform policy
        self._moving: dict[str, tuple[Move, float]] = {}  # where QoS should go, and since when (s)
        self._demand_since_s = math.inf
        self._owed: frozenset[str] = frozenset()  # topics whose swaps were over the budget

    def reconfigure(self, settings: Settings) -> None:
        """Take new settings; a new plan follows at the next tick."""
        self._settings = settings
        self._reload_pending = True

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self._begin()
        return Decision(plan=self.plan)

    def expect(self, now_s: float, topics: Sequence[Topic]) -> None:
        """Note the topics while the capacity is not known yet: they settle meanwhile."""
        self._note_crowd(now_s, {topic.name for topic in topics}, 0)

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
        rates : division of the budget of this tick
        lasting : division of the budget that holds most of the time; its periods become deadlines
        participants : processes across the link, which hear of each swap
        """
        self._now_s, self._lasting, self._topics, self._is_postponed = now_s, lasting, topics, False
        self._newest = min(MOST_GENERATION, max((each.generation for each in publishers), default=0))
        self._costs = partial(swap_costs, publishers, participants=participants)  # few looks make a plan
        if lasting.topics or self.plan.generation:
            self._swaps.fill(now_s, lasting.budget_bytes_per_second)
        cause = self._give_back(state, publishers)
        if lasting.topics and not cause:
            planned, others = self._planned, [each for each in publishers if each.topic not in self._planned]
            self._in_force = {**_rows_in_force(others), **planned}
            # After a restart the rows of the predecessor count as the previous plan.
            previous = {**_rows_in_force(other for other in others if other.generation > 0), **planned}
            self._wanted = Wanted(lasting, topics, publishers, previous=previous, settings=self._settings)
            self._now_sharing = lasting.uniform.topics if lasting.uniform else 0
            cause = self._follow_memory() or self._follow(state)
            self._is_postponed |= bool(self._owed)
        allowed = _allowed(rates, topics, is_out=state is LinkState.OUTAGE)
        return Decision(allowed=allowed, plan=self.plan, reason=cause, is_postponed=self._is_postponed)

    def _give_back(self, state: LinkState, publishers: Sequence[PublisherState]) -> str:
        """Give topics that cross the link no more their application's QoS back; return the cause, empty without a plan.

        It waits as all does that would only be better, but not where a reader would be lost to the QoS in force. The
        terms of the price stay: a far reader that returns finds no flood.
        """
        now_s, dwell_s, due = self._now_s, self._settings.governor.dwell_s, dict[str, TopicPlan]()
        self._note_left(state, publishers)
        lost = {each.topic for each in publishers if not is_kept(each.deadline_ns, each.requested_deadline_ns)}
        wait_s = _RISE_DWELLS * dwell_s if now_s - self._changed_at_s >= dwell_s else math.inf
        for name, (since_s, row) in sorted(self._left.items()):
            may_swap = name in lost or (now_s - since_s >= wait_s and self._swaps.has_room)
            if may_swap and row != self.plan.topics.get(name):
                self._swaps.spend(self._costs(), (name,))
                due[name] = row
        if not due:
            return ""
        cause = "readers" if lost & due.keys() else "topics"
        self._given_back.update(due)
        rows = {name: row for name, row in self._planned.items() if name not in due}
        self._take(rows, cause, self.plan.level_bytes_per_second)
        self._changed_at_s = now_s
        return cause

    def _note_left(self, state: LinkState, publishers: Sequence[PublisherState]) -> None:
        """Note topics that do not cross the link and carry a row of a plan, and the row that gives them back."""
        before, rows = self._left, dict[str, TopicPlan]()
        crossing = {each.topic for each in publishers if each.direction is not Direction.LOCAL}
        local = [each for each in publishers if each.topic not in crossing]
        for each in local:
            name, request_ns = each.topic, each.requested_deadline_ns
            if name in before or name in self.plan.topics or each.rate_hz < math.inf:  # also by a predecessor's plan
                terms = before[name][1] if name in before else self.plan.topics.get(name, own_qos(math.inf))
                row = rows.get(name, replace(terms, rate_hz=math.inf, deadline_ns=0, depth=0))
                if not is_kept(each.baseline_deadline_ns, request_ns):  # only arpd serves this reader
                    row = replace(row, deadline_ns=request_ns, depth=max(1, each.depth))
                rows[name] = row
        missing = {each.topic for each in local if each.topic in rows and not is_confirmed(each, rows[each.topic])}
        is_known = state is not LinkState.OUTAGE  # topics beyond a lost link are only silent
        self._left = {
            name: (before[name][0] if is_known and name in before else self._now_s, rows[name]) for name in missing
        }

    def _follow_memory(self) -> str:
        """Take depths that the memory of now allows; return ``memory``, or nothing where those in force do.

        A robot that runs out of memory waits for nothing: no hold, no budget of swaps, and no end of an outage.
        """
        if all(row.depth_binding is not Binding.MEMORY for row in self._lasting.topics):
            return ""
        slots = {topic.name: topic.slot_bytes for topic in self._topics}
        rows = {
            name: row
            if name in self._wanted.silent
            else replace(row, depth=min(row.depth, self._wanted.depths.get(name, row.depth)))
            for name, row in self._planned.items()
        }
        taken, less = (
            sum(slots[name] * row.depth for name, row in each.items() if name in slots)
            for each in (self._planned, rows)
        )
        if less >= (1.0 - _EXCESS) * taken:
            return ""
        self._swaps.spend(self._costs(), (name for name, row in rows.items() if row.qos != self._planned[name].qos))
        self._take(rows, "memory", self.plan.level_bytes_per_second)
        return "memory"

    def _follow(self, state: LinkState) -> str:
        """Make a plan if one is due, and put it into force; return its cause, empty without one.

        Terms go out at once. New QoS waits for the budget of swaps, but not where a reader would be lost.
        """
        if state is LinkState.OUTAGE:
            # A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._moving, self._demand_since_s = {}, math.inf
            return ""
        self._note_moves()
        if cause := self._cause():
            self._take(self._within_budget(), cause, self._lasting.budget_bytes_per_second)
            self._changed_at_s, self._reload_pending, self._sharing = self._now_s, False, self._now_sharing
            self._demand_since_s = self._differs_since_s = math.inf
        return cause

    def _note_moves(self) -> None:
        """Note since when QoS has not been what the program gives; while all is, the level follows."""
        now_s, level = self._now_s, self._lasting.budget_bytes_per_second
        start = (Move.NONE, now_s)
        self._moving = {
            name: before if (before := self._moving.get(name, start))[0] is move else (move, now_s)
            for name, move in self._wanted.moves.items()
            if name in self._planned
        }
        self._owed = self._owed.intersection(self._moving)  # not where a source fell silent, or its QoS fits again
        if self.plan.generation > 0 and not self._moving and level != self.plan.level_bytes_per_second:
            self.plan = replace(self.plan, level_bytes_per_second=level)
        has_demand = any(
            _differ(planned.rate_hz, row.rate_hz) or _differ(planned.wire_bytes, row.wire_bytes)
            for name, row in self._wanted.rows.items()
            if (planned := self._planned.get(name)) is not None
        )
        self._demand_since_s = min(self._demand_since_s, now_s) if has_demand else math.inf

    def _cause(self) -> str:
        """Return the cause of a plan that is due, empty if none is."""
        topics = self._planned
        if self._wanted.rows.keys() != topics.keys() or (
            self._now_sharing != self._sharing and not self._reload_pending
        ):
            if self._is_settled():
                return "topics" if self.plan.generation else "start"
            if not self.plan.generation:
                return ""
        else:
            self._crowd, self._differs_since_s = None, math.inf
        if self._reload_pending:
            return "reload"
        # A reader that requests a shorter deadline than the plan offers is disconnected.
        if not all(self._wanted.keeps_its_readers(name, row) for name, row in topics.items()):
            return "readers"
        return self._lasting_cause()

    def _is_settled(self) -> bool:
        """Return whether no topic has come or gone for the debounce, or some have all the time for the dwell."""
        g, now_s = self._settings.governor, self._now_s
        self._note_crowd(now_s, self._wanted.rows.keys(), self._now_sharing)
        self._differs_since_s = min(self._differs_since_s, now_s)
        return now_s - self._same_since_s >= g.debounce_s or now_s - self._differs_since_s >= g.dwell_s

    def _note_crowd(self, now_s: float, names: Collection[str], sharing: int) -> None:
        if (crowd := (frozenset(names), sharing)) != self._crowd:
            self._crowd, self._same_since_s = crowd, now_s

    def _lasting_cause(self) -> str:
        """Return the cause of a plan whose reason has lasted.

        Demand alone does not wait for the dwell: until its plan the publishers compute wrong rates.
        """
        g, now_s = self._settings.governor, self._now_s
        if now_s - self._demand_since_s >= g.hold_s:
            return "demand"
        if now_s - self._changed_at_s < g.dwell_s:
            return ""
        # Endpoints refuse plans older than that of a daemon that left or stepped back.
        if self.plan.generation < self._newest:
            return "takeover"
        lasts_s = {Move.RELAX: g.hold_s, Move.TIGHTEN: max(g.hold_s, _RISE_DWELLS * g.dwell_s)}
        ripe = {
            move
            for name, (move, since_s) in self._moving.items()
            if name not in self._owed and now_s - since_s >= lasts_s[move]
        }
        if not ripe:
            return "budget" if self._owed and self._swaps.is_full else ""
        if not self._swaps.has_room:
            self._is_postponed = True
            return ""
        return "down" if Move.RELAX in ripe else "up"

    def _take(self, rows: Mapping[str, TopicPlan], cause: str, level: float) -> None:
        generation = min(MOST_GENERATION, max(self._newest, self.plan.generation) + 1)
        self._planned = rows
        # Publishers that have it back need no row.
        self._given_back = {name: row for name, row in self._given_back.items() if name in self._left}
        self.plan = QosPlan(generation=generation, topics={**rows, **self._given_back}, level_bytes_per_second=level)
        self.plans_by_cause[cause] += 1

    def _within_budget(self) -> dict[str, TopicPlan]:
        """Return the rows to put into force; where a swap must wait, with the QoS of now. The heaviest go first."""
        wanted, in_force, costs = self._wanted, self._in_force, self._costs()
        changed = {name for name, row in wanted.rows.items() if name in in_force and in_force[name].qos != row.qos}
        urgent = {name for name in changed if not wanted.keeps_its_readers(name, in_force[name])}
        self._swaps.spend(costs, urgent)
        # A silent source gives QoS no basis.
        waiting = sorted(changed - urgent - wanted.silent, key=lambda name: (wanted.rows[name].weight, name))
        if self._now_sharing and self._swaps.has_room:
            self._swaps.spend(costs, waiting)  # topics that are all alike swap together
            waiting.clear()
        while waiting and self._swaps.has_room:
            self._swaps.spend(costs, (waiting.pop(),))
        self._owed = frozenset(waiting)
        held = self._owed | ((changed - urgent) & wanted.silent)
        return {
            name: wanted.with_qos_of(row, name, in_force[name]) if name in held else row
            for name, row in wanted.rows.items()
        }


def _allowed(rates: Allocation, topics: Sequence[Topic], *, is_out: bool) -> float:
    """Return the part of the traffic above the floors that the price allows; where there is none, what it would be."""
    wanted = sum(topic.wire_bytes * max(0.0, topic.desired_rate_hz - topic.min_rate_hz) for topic in topics)
    pairs = zip(rates.topics, topics, strict=True)
    allowed = sum(topic.wire_bytes * max(0.0, row.rate_hz - topic.min_rate_hz) for row, topic in pairs)
    return min(1.0, allowed / wanted) if wanted > 0 else float(not is_out)


def _differ(planned: float, now: float) -> bool:
    return not (1.0 - _DEMAND_CHANGE) * planned <= now <= (1.0 + _DEMAND_CHANGE) * planned


def _rows_in_force(publishers: Iterable[PublisherState]) -> dict[str, TopicPlan]:
    return {
        each.topic: TopicPlan(
            rate_hz=each.rate_hz, min_rate_hz=0.0, deadline_ns=each.deadline_ns, depth=max(1, each.depth)
        )
        # Of one topic the shortest history counts: a node refuses one beyond the bounds that is not its own.
        for each in sorted(publishers, key=lambda publisher: publisher.depth, reverse=True)
    }
