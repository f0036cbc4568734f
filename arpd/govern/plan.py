"""Rows of a plan, in classes, so that noise swaps no writer, and how far a plan has come by what nodes tell."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.plan import QosPlan, TopicPlan, is_kept
from arpd.model.wire import FRAGMENT_BYTES
from arpd.solve.eq4 import LONGEST_PERIOD_NS, alike

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from arpd.model.allocation import Allocation, Topic, TopicAllocation
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings

# 1.5 s and its halves: the periods of usual rates (1, 2, 5, 10, 20, 30 Hz) with the default slack lie well inside the
# classes, so the noise of a measured rate does not cross a border.
_SHORTEST_NS = 5_859_375
# What is in force stays while it is at most so far beyond what the program gives, as a factor or in samples.
_TOLERANCE, _SAMPLES = 1.1, 1
# A shorter deadline or a deeper history must still fit when the program gives so much less.
_ROOM = 1.25
# A timer of Linux wakes up to some milliseconds late, and a reader's clock runs from arrival to arrival: at 200 Hz a
# quarter of the period alone missed 95 deadlines in 20 s on an idle link.
_LEAST_SLACK_NS = 10_000_000
# The ceiling is above the source's rate, so jitter and a little growth are not throttled. More growth is a change of
# demand, and causes a new plan.
_SOURCE_MARGIN = 1.25
_SIX_DIGITS = 1e-4  # which a snapshot has of a rate and of the lease


class Move(IntEnum):
    """Direction in which the QoS in force should go."""

    RELAX = -1  # it promises more than the program gives: a deadline too short, or a history too deep
    NONE = 0
    TIGHTEN = 1  # it could promise more


class _Fit:
    """What the program gives a topic, and the QoS that is no harder to keep: in classes, or exactly.

    Parameters
    ----------
    request_ns : tightest deadline that a reader requests, which bounds the offered one exactly; 0 = none (ns)
    slack : of the period, so that jitter misses no deadline
    """

    def __init__(self, row: TopicAllocation, topic: Topic, *, request_ns: int, slack: float, is_exact: bool) -> None:
        self._topic, self._request_ns, self._is_exact = topic, request_ns, is_exact
        self._period_ns, self._given = row.deadline_ns, row.depth_applied
        offered_ns = max(math.ceil(self._period_ns * slack), self._period_ns + _LEAST_SLACK_NS)
        self._offered_ns = min(offered_ns, LONGEST_PERIOD_NS) if self._period_ns else 0
        self.depth, self.deadline_ns = self._depth(self._given), self._deadline_ns(self._offered_ns)

    def move(self, kept: TopicPlan) -> Move:
        """Return where a row should go that now has other QoS; NONE while it is near enough."""
        if kept.qos == (self.depth, self.deadline_ns):
            return Move.NONE
        keeps_deadline = self._period_ns and max(self._period_ns, self._offered_ns / _TOLERANCE) <= kept.deadline_ns
        if _is_longer(self.deadline_ns, kept.deadline_ns) and not keeps_deadline:
            return Move.RELAX
        if kept.depth > min(self._topic.max_depth, max(_TOLERANCE * self._given, self._given + _SAMPLES)):
            return Move.RELAX
        could_be_shorter = _is_longer(kept.deadline_ns, self._deadline_ns(int(_ROOM * self._offered_ns)))
        # What the configuration asks for needs no room to spare.
        roomy_depth = max(self._depth(max(1, int(self._given / _ROOM))), min(self._given, self._topic.min_depth))
        return Move.TIGHTEN if could_be_shorter or kept.depth < roomy_depth else Move.NONE

    def _deadline_ns(self, offered_ns: int) -> int:
        """Return the shortest class of 5859375·2ᵏ ns that is at least as long, but no more than readers request."""
        if offered_ns > 0 and not self._is_exact:
            longer_ns = _SHORTEST_NS << ((offered_ns - 1) // _SHORTEST_NS).bit_length()
            offered_ns = min(LONGEST_PERIOD_NS, longer_ns)
        return self._request_ns if _is_longer(offered_ns, self._request_ns) else offered_ns

    def _depth(self, depth: int) -> int:
        """Return the largest power of two that is at most as deep; the bounds of the configuration are classes, too."""
        if self._is_exact or depth >= self._topic.max_depth:
            return depth
        return max(min(depth, self._topic.min_depth), 1 << (depth.bit_length() - 1))


def _is_longer(one_ns: int, other_ns: int) -> bool:
    """Return whether one deadline is longer than another (0 = infinite)."""
    return other_ns > 0 and (one_ns == 0 or one_ns > other_ns)


class Wanted:
    """What the program would give every topic now.

    A row whose class still fits keeps its writer. The uniform policy has no classes: its rows have the exact optimum. A
    silent source keeps its ceiling and its QoS: it costs nothing now, and finds them when it returns.

    Parameters
    ----------
    allocation : answer of the program for the budget that lasts
    previous : rows of the plan before

    Attributes
    ----------
    rows : of every topic
    moves : where QoS should go; a topic that is missing is where it should be
    depths : that the allocation gives, in their classes (samples)
    requests : tightest deadline that readers request, by topic (ns)
    silent : topics that nobody publishes on
    """

    def __init__(
        self,
        allocation: Allocation,
        topics: Sequence[Topic],
        publishers: Sequence[PublisherState],
        *,
        previous: Mapping[str, TopicPlan],
        settings: Settings,
    ) -> None:
        self.rows: dict[str, TopicPlan] = {}
        self.moves: dict[str, Move] = {}
        self.depths: dict[str, int] = {}
        self.requests: dict[str, int] = {}
        for publisher in publishers:
            if requested_ns := publisher.requested_deadline_ns:
                self.requests[publisher.topic] = min(requested_ns, self.requests.get(publisher.topic, requested_ns))
        self.silent = frozenset(p.topic for p in publishers) - {p.topic for p in publishers if p.source_rate_hz > 0}
        large = {publisher.topic for publisher in publishers if publisher.payload_bytes > FRAGMENT_BYTES}
        slack, is_exact = settings.program.deadline_slack, allocation.uniform is not None
        for given, topic in zip(allocation.topics, topics, strict=True):
            name, kept = topic.name, previous.get(topic.name)
            fit = _Fit(given, topic, request_ns=self.requests.get(name, 0), slack=slack, is_exact=is_exact)
            self.depths[name] = fit.depth
            row = TopicPlan(
                rate_hz=_SOURCE_MARGIN * topic.desired_rate_hz,
                min_rate_hz=topic.min_rate_hz,
                deadline_ns=fit.deadline_ns,
                depth=fit.depth,
                weight=topic.weight,
                wire_bytes=topic.wire_bytes,
                packets=topic.packets,
            )
            if name in self.silent:
                row = self._silent(row, name, kept, is_large=name in large)
            elif kept is not None:
                if (move := fit.move(kept)) is Move.NONE:
                    row = self.with_qos_of(row, name, kept)
                else:
                    self.moves[name] = move
            if (most_hz := settings.topic(name).max_rate_hz) is not None:
                row = replace(row, rate_hz=min(row.rate_hz, most_hz), max_rate_hz=most_hz)
            self.rows[name] = alike(row) if is_exact else row

    def keeps_its_readers(self, name: str, row: TopicPlan) -> bool:
        """Return whether no reader of a topic would disconnect."""
        return is_kept(row.deadline_ns, self.requests.get(name, 0))

    def with_qos_of(self, row: TopicPlan, name: str, kept: TopicPlan) -> TopicPlan:
        """Return a row with the QoS of another one, unless a reader would disconnect."""
        return (
            replace(row, depth=kept.depth, deadline_ns=kept.deadline_ns) if self.keeps_its_readers(name, kept) else row
        )

    def _silent(self, row: TopicPlan, name: str, kept: TopicPlan | None, *, is_large: bool) -> TopicPlan:
        """Return the row of a silent source: rate and period are unknown, so new ones would have no basis.

        Where no rate was ever known, small samples have no ceiling, and large ones begin slowly, as before any plan.
        """
        row = replace(row, deadline_ns=self.requests.get(name, 0))
        if kept is None:
            return row if is_large else replace(row, rate_hz=math.inf)
        row = replace(row, rate_hz=kept.rate_hz)
        if kept.weight > 0 and kept.packets:  # a size includes the heartbeats of a sample, which depend on the rate
            row = replace(row, wire_bytes=kept.wire_bytes, packets=kept.packets)
        return self.with_qos_of(row, name, kept)


class Progress(NamedTuple):
    """Nodes that do not show a plan, or whose publishers do not show their rows; publishers that show their row."""

    missing: frozenset[str] = frozenset()
    confirmed: int = 0


def progress(publishers: Iterable[PublisherState], plan: QosPlan, *, lease_s: float = 0.0) -> Progress:
    """Return how far a plan has come; publishers without a row do not count.

    No snapshot shows the terms of the price. They are in force where the plan's generation is.

    Parameters
    ----------
    lease_s : silence after which nodes return to their own QoS, 0 = never (s)
    """
    missing, confirmed = set(), 0
    for publisher in publishers:
        if (row := plan.topics.get(publisher.topic)) is None:
            continue
        has_row = is_confirmed(publisher, row)
        confirmed += has_row
        has_lease = math.isclose(publisher.lease_s, lease_s, rel_tol=_SIX_DIGITS)
        if not (has_row and has_lease and publisher.generation == plan.generation):
            missing.add(publisher.node)
    return Progress(frozenset(missing), confirmed)


def is_confirmed(publisher: PublisherState, row: TopicPlan) -> bool:
    """Return whether a publisher shows the row in force.

    A publisher that refuses new QoS for good is confirmed by its ceiling: it is paced, and takes no more.
    """
    if not math.isclose(publisher.rate_hz, row.rate_hz, rel_tol=_SIX_DIGITS):
        return False
    depth, deadline_ns = publisher.qos_by(row)
    has_depth = publisher.keeps_all or publisher.depth == depth
    return publisher.refusal_reason.is_lasting or (has_depth and publisher.deadline_ns == deadline_ns)
