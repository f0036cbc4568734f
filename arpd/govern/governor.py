"""Governor: turns measurements into action, the gate at every tick and the level (a QoS swap) rarely.

Design: docs/design.md, The governor.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import replace
from typing import TYPE_CHECKING

from arpd.govern.memory import MemoryWatch
from arpd.govern.plan import make_plan, tightest_requests
from arpd.model.allocation import Allocation, AllocationStatus, Topic
from arpd.model.link import LinkEstimate, LinkState
from arpd.model.plan import MOST_GENERATION, Decision, QosPlan, TopicPlan, keeps_its_readers

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

_GATE_CLOSED = 0.01  # only floors flow
_DRAIN_S = 0.08  # a queue this far above the allowance closes the gate
_FLAP_S = 15.0  # after a rise; a fall in this time is flapping
_FLAP_HOLD = 2.0  # times the hold, at least, for such a fall
_DEEP, _SHALLOW = 1.3, 8.0  # times the hold: for a fall to nearly nothing, and for one barely out of the band
_LEAST_HOLD = 0.25  # times the hold, in the most urgent case
_LEAK = 0.25  # of the other time, subtracted from the time above
_CALM_S = 60.0
_DEMAND_CHANGE = 0.25
_NO_PLAN = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


class Governor:
    """Decides on two actuators: the gate is instant and free; a new level costs swaps, so discovery and time.

    Parameters
    ----------
    settings : thresholds, dwell, deadband, budget
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._plan = _NO_PLAN
        self._below_since_s: float | None = None
        self._above_s = 0.0  # less a part of the other time: a link that swings is used at its better half
        self._looked_at_s = -math.inf
        self._elapsed_s = 0.0
        self._demand_since_s: float | None = None
        self._topics: frozenset[str] = frozenset()
        self._planned_overhead_s = 0.0
        self._planned_for: dict[str, tuple[float, float]] = {}  # wanted bytes/s and given Hz
        self._seen: frozenset[str] = frozenset()
        self._seen_since_s = -math.inf
        self._changed_at_s = -math.inf
        self._calmed_at_s = -math.inf
        self._up_at_s = -math.inf
        self._took_over_s = -math.inf
        self._dwell_s = settings.governor.dwell_s
        self._reload_pending = False
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
        """Number of refused plans so far, by reason."""
        return dict(self._refusals)

    def reconfigure(self, settings: Settings) -> None:
        """Take new settings; a new plan follows at the next tick."""
        self._settings = settings
        self._dwell_s = settings.governor.dwell_s
        self._reload_pending = True

    def decide(
        self,
        now_s: float,
        *,
        link: LinkEstimate,
        allocation: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
        newest: int = 0,
    ) -> Decision:
        """Decide gate and plan for this tick; ``newest`` is the newest generation that any reader announces."""
        newest = min(MOST_GENERATION, max([newest, *(publisher.generation for publisher in publishers)]))
        self._elapsed_s, self._looked_at_s = max(0.0, min(1.0, now_s - self._looked_at_s)), now_s
        silent = {p.topic for p in publishers} - {p.topic for p in publishers if p.source_rate_hz > 0}
        if self._memory.calls_for_depths(now_s, allocation, self._planned(topics), besides=silent):
            return self._follow_memory(now_s, link, allocation, topics, newest, besides=silent)
        cause, refusal = self._cause(now_s, link, allocation, topics, publishers)
        if not cause and 0 < self._plan.generation < newest and allocation.topics and link.state != LinkState.OUTAGE:
            # Endpoints have a newer plan of a daemon that left or stepped back, and refuse older ones. The dwell bounds
            # how often invented generations cause a plan.
            if now_s - self._took_over_s >= self._settings.governor.dwell_s:
                cause, self._took_over_s = "takeover", now_s
            else:
                refusal = "dwell"
        refusals = [refusal] if refusal else []
        if cause:
            plan = self._next_plan(allocation, topics, publishers, newest)
            swaps = sum(_changes_qos(self._plan.topics.get(name), row) for name, row in plan.topics.items())
            if self._is_over_budget(now_s, swaps):
                refusals.append("budget")
                cause = ""
            else:
                self._adopt(plan, cause, swaps, now_s)
                self._memory.note_plan(allocation)
                self._planned_for = _demand(topics, allocation)
                self._planned_overhead_s = link.available_packet_overhead_s
        self._refusals.update(reason for reason in refusals if reason not in self._refused)
        self._refused = frozenset(refusals)
        self._calm(now_s)
        return Decision(
            gate=self._gate(link, topics),
            plan=self._plan,
            level_changed=bool(cause),
            reason=cause,
            refusals=tuple(refusals),
        )

    def stand_by(self) -> Decision:
        """Plan nothing; the next `decide` starts without a plan."""
        self._plan = _NO_PLAN
        self._topics = self._seen = frozenset()
        return Decision(gate=1.0, plan=self._plan, level_changed=False, reason="", refusals=())

    # -- memory

    def _follow_memory(
        self,
        now_s: float,
        link: LinkEstimate,
        allocation: Allocation,
        topics: Sequence[Topic],
        newest: int,
        *,
        besides: Collection[str],
    ) -> Decision:
        """Give the plan in force the depths that memory allows; its rates stay, because the link has not changed.

        Neither the swap budget nor an outage delays this: histories fill in an outage.
        """
        given = {row.name: row.depth_applied for row in allocation.topics if row.name not in besides}
        rows = {name: replace(row, depth=given.get(name, row.depth)) for name, row in self._plan.topics.items()}
        swaps = sum(_changes_qos(self._plan.topics[name], row) for name, row in rows.items())
        self._plan = replace(self._plan, generation=self._next_generation(newest), topics=rows)
        self._swapped.append((now_s, swaps))
        self._levels["memory"] += 1
        self._memory.note_depths(now_s, allocation)
        return Decision(
            gate=self._gate(link, topics), plan=self._plan, level_changed=True, reason="memory", refusals=()
        )

    # -- the level

    def _cause(
        self,
        now_s: float,
        link: LinkEstimate,
        allocation: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
    ) -> tuple[str, str]:
        """Return the cause of a plan that is due, and the reason to refuse one; either may be empty."""
        if allocation.status is AllocationStatus.EMPTY:
            return "", ""
        if link.state is LinkState.OUTAGE and self._plan.generation > 0:
            # The gate is closed. A plan for a lost link would be a guess, and topics beyond it are only silent.
            self._forget_changes()
            return "", ""
        names = frozenset(topic.name for topic in topics)
        if names != self._topics:
            return self._topics_cause(now_s, names), ""
        self._seen = names
        if self._reload_pending:
            return "reload", ""
        if self._loses_readers(publishers):
            return "readers", ""
        return self._level_cause(now_s, link, allocation, topics)

    def _loses_readers(self, publishers: Sequence[PublisherState]) -> bool:
        """Return whether a reader requests a shorter deadline than the plan offers, so it is disconnected."""
        requests = tightest_requests(publishers)
        return any(not keeps_its_readers(row, requests.get(topic, 0)) for topic, row in self._plan.topics.items())

    def _topics_cause(self, now_s: float, names: frozenset[str]) -> str:
        """Debounce topics that come and go, so a node with ten topics costs one plan."""
        if names != self._seen:
            self._seen, self._seen_since_s = names, now_s
        if now_s - self._seen_since_s < self._settings.governor.debounce_s:
            return ""
        return "start" if self._plan.generation == 0 else "topics"

    def _level_cause(
        self, now_s: float, link: LinkEstimate, allocation: Allocation, topics: Sequence[Topic]
    ) -> tuple[str, str]:
        g = self._settings.governor
        packets_per_byte = self._packets_per_byte(topics)
        level = self._useful(self._plan.level_bytes_per_second, self._planned_overhead_s, packets_per_byte)
        overhead_s = link.available_packet_overhead_s
        capacity = self._useful(allocation.capacity_bytes_per_second, overhead_s, packets_per_byte)
        below, above = capacity < g.down_ratio * level, capacity > g.up_ratio * level
        moved = not below and not above and self._demand_moved(_demand(topics, allocation))
        self._above_s = max(
            0.0, self._above_s + self._elapsed_s * (_urgency(capacity, level, g.up_ratio) if above else -_LEAK)
        )
        self._below_since_s = _since(below, self._below_since_s, now_s)
        self._demand_since_s = _since(moved, self._demand_since_s, now_s)
        since_change_s = now_s - self._changed_at_s
        if below and self._held_s(self._below_since_s, now_s) >= self._down_hold_s(
            now_s, link, topics, capacity / level
        ):
            return "down", ""
        if above and self._above_s >= g.hold_s:
            return ("up", "") if since_change_s >= self._dwell_s else ("", "dwell")
        if moved and self._held_s(self._demand_since_s, now_s) >= g.hold_s:
            return ("demand", "") if since_change_s >= g.dwell_s else ("", "dwell")
        return "", ""

    def _planned(self, topics: Sequence[Topic]) -> list[tuple[Topic, TopicPlan]]:
        """Pair every topic in the plan in force with its row."""
        return [(topic, row) for topic in topics if (row := self._plan.topics.get(topic.name)) is not None]

    def _packets_per_byte(self, topics: Sequence[Topic]) -> float:
        """Return the packets per byte that the plan sends; 0 when it sends nothing."""
        rates = [(topic, min(row.rate_hz, topic.desired_rate_hz)) for topic, row in self._planned(topics)]
        size = sum(topic.wire_bytes * rate_hz for topic, rate_hz in rates)
        return sum(topic.packets * rate_hz for topic, rate_hz in rates) / size if size > 0 else 0.0

    def _useful(self, level: float, overhead_s: float, packets_per_byte: float) -> float:
        """Return the part of a level left for the plan's topics when each packet costs ``overhead_s`` (bytes/s).

        A byte of many small messages takes longer than one of a few large ones: R/(1 + t·C·Σk/Σs).
        """
        return level / (1.0 + overhead_s * level / self._settings.link.headroom * packets_per_byte)

    def _down_hold_s(self, now_s: float, link: LinkEstimate, topics: Sequence[Topic], ratio: float) -> float:
        """Return how long a fall must last before it is worth swaps (s).

        Most falls pass, and the gate bridges them. A deep fall waits less, because the gate cuts all topics alike and
        only a plan knows their weights. A fall right after a rise waits longer, more so when the link swung often.
        When the floors of the plan alone exceed the link, the gate cannot help, and the wait is short.
        """
        g = self._settings.governor
        floors = sum(_link_bytes(topic, link) * row.min_rate_hz for topic, row in self._planned(topics))
        if floors > self._settings.link.headroom * link.available_bytes_per_second:
            return g.hold_s * max(_LEAST_HOLD, ratio)
        hold_s = g.hold_s * (_DEEP + (_SHALLOW - _DEEP) * (ratio / g.down_ratio) ** 3)
        if now_s - self._up_at_s > _FLAP_S:
            return hold_s
        return max(hold_s, g.hold_s * _FLAP_HOLD * max(1.0, self._dwell_s / max(g.dwell_s, 1e-3)))

    @staticmethod
    def _held_s(since_s: float | None, now_s: float) -> float:
        return now_s - since_s if since_s is not None else 0.0

    def _forget_changes(self) -> None:
        self._below_since_s = self._demand_since_s = None
        self._above_s = 0.0

    def _demand_moved(self, demand: Mapping[str, tuple[float, float]]) -> bool:
        """Return whether a source wants something else than when the plan was made, and would get it.

        Rates that only follow the capacity do not count: what remains for large topics moves by far more than the
        capacity.
        """
        return any(
            all(_differ(before, now) for before, now in zip(planned_for, demand[name], strict=True))
            for name, planned_for in self._planned_for.items()
            if name in demand
        )

    def _next_plan(
        self, allocation: Allocation, topics: Sequence[Topic], publishers: Sequence[PublisherState], newest: int
    ) -> QosPlan:
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

    def _is_over_budget(self, now_s: float, swaps: int) -> bool:
        while self._swapped and now_s - self._swapped[0][0] > 60.0:
            self._swapped.popleft()
        spent = sum(count for _, count in self._swapped)
        return bool(self._swapped) and spent + swaps > self._settings.governor.swaps_per_minute

    def _adopt(self, plan: QosPlan, cause: str, swaps: int, now_s: float) -> None:
        g = self._settings.governor
        if cause == "down" and now_s - self._up_at_s <= _FLAP_S:
            self._dwell_s = min(2 * self._dwell_s, g.dwell_max_s)
        if cause == "up":
            self._up_at_s = now_s
        self._plan = plan
        self._topics = frozenset(plan.topics)
        self._changed_at_s = now_s
        self._forget_changes()
        self._reload_pending = False
        self._swapped.append((now_s, swaps))
        self._levels[cause] += 1

    def _calm(self, now_s: float) -> None:
        dwell_s = self._settings.governor.dwell_s
        if self._dwell_s > dwell_s and now_s - max(self._changed_at_s, self._calmed_at_s) >= _CALM_S:
            self._dwell_s = max(dwell_s, self._dwell_s / 2)
            self._calmed_at_s = now_s

    # -- the gate

    def _gate(self, link: LinkEstimate, topics: Sequence[Topic]) -> float:
        """Return the factor on every paced rate that fits the plan to what the link carries now."""
        if link.state is LinkState.OUTAGE:
            return _GATE_CLOSED
        planned = sum(
            _link_bytes(topic, link) * min(row.rate_hz, max(topic.desired_rate_hz, topic.min_rate_hz))
            for topic, row in self._planned(topics)
        )
        if planned <= 0:
            return 1.0
        usable = self._settings.link.headroom * link.available_bytes_per_second
        gate = min(1.0, usable / planned)
        # The gate is free and instant, so it answers the first delayed ping, before the estimator is certain.
        excess_s = link.queue_delay_s - link.queue_allowance_s
        return max(_GATE_CLOSED, gate * min(1.0, 1.0 - excess_s / _DRAIN_S))


def _inherited(publishers: Sequence[PublisherState]) -> dict[str, TopicPlan]:
    """Return the rows that a predecessor left in force; a restarted daemon keeps those that are near enough."""
    return {
        publisher.topic: TopicPlan(
            rate_hz=publisher.rate_hz, min_rate_hz=0.0, deadline_ns=publisher.deadline_ns, depth=publisher.depth
        )
        for publisher in publishers
        if publisher.generation > 0 and math.isfinite(publisher.rate_hz)
    }


def _link_bytes(topic: Topic, link: LinkEstimate) -> float:
    """Return the bytes that the link carries in the time of one message, with the overhead of its packets."""
    return topic.wire_bytes + topic.packets * link.packet_overhead_s * link.capacity_bytes_per_second


def _urgency(capacity: float, level: float, up_ratio: float) -> float:
    """Return the weight of time above the level: a small rise may be noise, and loses little by waiting."""
    return min(1.0, (capacity / (up_ratio * level)) ** 2 / _SHALLOW) if level > 0 else 1.0


def _changes_qos(old: TopicPlan | None, new: TopicPlan) -> bool:
    return old is None or (old.depth, old.deadline_ns) != (new.depth, new.deadline_ns)


def _demand(topics: Sequence[Topic], allocation: Allocation) -> dict[str, tuple[float, float]]:
    """Return what every topic wants of the link (bytes/s) and what it would get (Hz)."""
    wanted = {topic.name: topic.wire_bytes * topic.desired_rate_hz for topic in topics}
    return {row.name: (wanted[row.name], row.rate_hz) for row in allocation.topics}


def _differ(before: float, now: float) -> bool:
    return abs(before - now) > _DEMAND_CHANGE * max(before, now)


def _since(holds: bool, since_s: float | None, now_s: float) -> float | None:  # noqa: FBT001 - a condition, not a mode
    """Start, keep or clear the time since which a condition holds."""
    if not holds:
        return None
    return now_s if since_s is None else since_s
