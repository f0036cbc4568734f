"""Classes of depth and deadline: a plan moves both in steps of two, so that little changes swap no writer."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.plan import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.plan import TopicPlan

#: DDS counts whole seconds in 32 bits (DDS 1.4 §2.3.2, Duration_t).
LONGEST_DEADLINE_NS = (2**31 - 1) * NANOSECONDS_PER_SECOND
# 1.5 s and its halves: the periods of usual rates (1, 2, 5, 10, 20, 30 Hz) with the default slack lie well inside the
# classes, so the noise of a measured rate does not cross a border.
_SHORTEST_NS = 5_859_375
# What is in force stays while it is at most so far beyond what the program gives, as a factor or in samples.
_TOLERANCE, _SAMPLES = 1.1, 1
# A shorter deadline or a deeper history must still fit when the program gives so much less.
_ROOM = 1.25


class Move(IntEnum):
    """Direction in which the QoS in force should go."""

    RELAX = -1  # it promises more than the program gives: a deadline too short, or a history too deep
    NONE = 0
    TIGHTEN = 1  # it could promise more


class Ladder(NamedTuple):
    """Steps of deadline (ns) and depth (samples): the nearest one that is no harder to keep than the exact value."""

    deadline_ns: Callable[[int], int]
    depth: Callable[[int], int]


def class_of_deadline(deadline_ns: int) -> int:
    """Return the class of a deadline: the shortest of 5859375·2ᵏ ns that is at least as long; 0 = none stays (ns)."""
    if deadline_ns <= 0:
        return 0
    return min(LONGEST_DEADLINE_NS, _SHORTEST_NS << ((deadline_ns - 1) // _SHORTEST_NS).bit_length())


def class_of_depth(depth: int) -> int:
    """Return the class of a depth: the largest power of two that is at most as deep (samples)."""
    return 1 << (depth.bit_length() - 1)


CLASSES = Ladder(class_of_deadline, class_of_depth)
EXACT = Ladder(lambda deadline_ns: deadline_ns, lambda depth: depth)


class Fit(NamedTuple):
    """What the program gives a topic, before classes.

    Parameters
    ----------
    period_ns : period of the rate, 0 = paused (ns)
    offered_ns : the same with slack, 0 = none (ns)
    request_ns : tightest deadline that a reader requests, 0 = none (ns)
    depth : history that the program allows (samples)
    least_depth, most_depth : bounds of the configuration, which are classes of their own (samples)
    """

    period_ns: int
    offered_ns: int
    request_ns: int
    depth: int
    least_depth: int
    most_depth: int

    def qos(self, ladder: Ladder) -> tuple[int, int]:
        """Return depth and deadline in their classes; a reader's request bounds the deadline exactly."""
        return self._depth(ladder, self.depth), self._deadline_ns(ladder, self.offered_ns)

    def move(self, kept: TopicPlan, ladder: Ladder) -> Move:
        """Return where a row should go that now has other QoS; NONE while it is near enough."""
        depth, deadline_ns = self.qos(ladder)
        if (kept.depth, kept.deadline_ns) == (depth, deadline_ns):
            return Move.NONE
        if _is_longer(deadline_ns, kept.deadline_ns) and not self._keeps_deadline(kept.deadline_ns):
            return Move.RELAX
        if kept.depth > min(self.most_depth, max(_TOLERANCE * self.depth, self.depth + _SAMPLES)):
            return Move.RELAX
        roomy_ns = self._deadline_ns(ladder, int(_ROOM * self.offered_ns))
        roomy_depth = self._depth(ladder, max(1, int(self.depth / _ROOM)))
        could_be_shorter = _is_longer(kept.deadline_ns, roomy_ns)
        # What the configuration asks for needs no room to spare.
        could_be_deeper = kept.depth < max(roomy_depth, min(self.depth, self.least_depth))
        return Move.TIGHTEN if could_be_shorter or could_be_deeper else Move.NONE

    def _keeps_deadline(self, deadline_ns: int) -> bool:
        """Return whether the rate keeps a deadline, with most of its slack."""
        return bool(self.period_ns) and max(self.period_ns, self.offered_ns / _TOLERANCE) <= deadline_ns

    def _deadline_ns(self, ladder: Ladder, offered_ns: int) -> int:
        deadline_ns = ladder.deadline_ns(offered_ns)
        return self.request_ns if _is_longer(deadline_ns, self.request_ns) else deadline_ns

    def _depth(self, ladder: Ladder, depth: int) -> int:
        return depth if depth >= self.most_depth else max(min(depth, self.least_depth), ladder.depth(depth))


def _is_longer(one_ns: int, other_ns: int) -> bool:
    """Return whether one deadline is longer than another (0 = infinite)."""
    return other_ns > 0 and (one_ns == 0 or one_ns > other_ns)
