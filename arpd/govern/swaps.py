"""Swaps: for how long QoS has not been what the program gives, and what swaps may cost the link."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from arpd.govern.classes import Move
from arpd.model.wire import swap_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan

_PART = 0.01  # of the lasting budget
_BURST_S = 30.0
_FULL = 0.9  # of the burst; the lasting budget, and so the burst, may grow all the time
# Readers beside the writers of a relay, and what every node has: parameter services, /rosout, arpd's own topics.
_ENDPOINTS_PER_PUBLISHER, _ENDPOINTS_OF_A_NODE = 2, 20
_CLASSES_TO_NONE = 4.0  # between any deadline and none


class SwapBudget:
    """Token bucket of the discovery bytes that swaps may put on the link.

    A new writer makes Fast DDS describe it to every participant, and ROS describe all endpoints of its process, and so
    does the end of the old one. So a swap costs the more, the more endpoints its process has.
    """

    def __init__(self) -> None:
        self._left = math.inf
        self._most = 0.0
        self._filled_at_s = -math.inf

    def fill(self, now_s: float, bytes_per_second: float) -> None:
        """Add what a lasting budget allows since the last time."""
        rate = _PART * bytes_per_second
        elapsed_s, self._filled_at_s = max(0.0, now_s - self._filled_at_s), now_s
        self._most = _BURST_S * rate
        self._left = max(-self._most, min(self._most, self._left + rate * min(elapsed_s, _BURST_S)))

    @property
    def has_room(self) -> bool:
        """True while a swap may begin; the last one may cost more than what is left."""
        return self._left > 0

    @property
    def is_full(self) -> bool:
        """True when enough has come together for a plan that only brings owed swaps."""
        return self._left >= _FULL * self._most

    def spend(self, costs: Mapping[str, float], names: Iterable[str]) -> None:
        """Take the costs of the swaps of these topics, also of those that could not wait."""
        self._left -= sum(costs.get(name, 0.0) for name in names)

    def choose(self, costs: Mapping[str, float], uses: Mapping[str, float]) -> frozenset[str]:
        """Return the topics that must wait, and spend the costs of the others; most use per byte goes first."""
        waiting = sorted(uses, key=lambda name: (uses[name] / max(1.0, costs[name]), name))
        while waiting and self.has_room:
            self.spend(costs, (waiting.pop(),))
        return frozenset(waiting)


class Drift:
    """Since when the QoS of each topic has not been what the program gives."""

    def __init__(self) -> None:
        self._since: dict[str, tuple[Move, float]] = {}

    def note(self, now_s: float, moves: Mapping[str, Move]) -> None:
        """Note where the topics' QoS should go now; a topic that is missing is where it should be."""
        unknown = (Move.NONE, now_s)
        self._since = {
            name: before if (before := self._since.get(name, unknown))[0] is move else (move, now_s)
            for name, move in moves.items()
            if move is not Move.NONE
        }

    def __bool__(self) -> bool:
        """Return whether a topic should change."""
        return bool(self._since)

    def is_relaxing(self, name: str) -> bool:
        """Return whether the QoS in force promises more than the program gives."""
        return self._since.get(name, (Move.NONE, 0.0))[0] is Move.RELAX

    def ripe(self, now_s: float, *, relax_s: float, tighten_s: float, owed: frozenset[str]) -> frozenset[str]:
        """Return the topics whose change has lasted, and those among the owed ones that should still change."""
        least_s = {Move.RELAX: relax_s, Move.TIGHTEN: tighten_s}
        return frozenset(
            name for name, (move, since_s) in self._since.items() if name in owed or now_s - since_s >= least_s[move]
        )


def swap_costs(publishers: Sequence[PublisherState], *, participants: int) -> dict[str, float]:
    """Return the discovery bytes that new QoS of each topic puts on the link.

    A publisher that refuses new QoS for good costs nothing.

    Parameters
    ----------
    participants : processes across the link
    """
    of_node = Counter(publisher.node for publisher in publishers)
    by_node = {
        node: participants * swap_bytes(_ENDPOINTS_OF_A_NODE + _ENDPOINTS_PER_PUBLISHER * count)
        for node, count in of_node.items()
    }
    costs: dict[str, float] = {}
    for publisher in publishers:
        cost = 0.0 if publisher.refusal_reason.is_lasting else by_node[publisher.node]
        costs[publisher.topic] = costs.get(publisher.topic, 0.0) + cost
    return costs


def usefulness(before: TopicPlan, after: TopicPlan) -> float:
    """Return the use of a swap: the classes that depth and deadline move by, times the weight of the topic."""
    moved = abs(math.log2(after.depth / before.depth))
    if before.deadline_ns and after.deadline_ns:
        moved += abs(math.log2(after.deadline_ns / before.deadline_ns))
    elif before.deadline_ns or after.deadline_ns:
        moved += _CLASSES_TO_NONE
    return moved * after.weight
