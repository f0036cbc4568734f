"""Sets of samples with one header stamp, which cross the link whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.ros.cdr import stamp_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from arpd.relay.envelope import Record

_MOST_BEGUN = 64  # sets that wait for their last sample


class Sets:
    """Collects the samples of a group of topics into sets.

    A set is complete when each member that is carried has given a sample with its stamp. The samples of one writer
    arrive in order, so a set that is older than a complete one will never be complete, and is dropped.

    Parameters
    ----------
    members : places in the group of the topics that are carried; they may change
    on_drop : called with the number of samples of a set that was never complete
    """

    def __init__(self, members: Collection[int], *, on_drop: Callable[[int], None]) -> None:
        self.members = frozenset(members)
        self._on_drop = on_drop
        self._begun: dict[tuple[int, int], dict[int, Record]] = {}

    def add(self, member: int, record: Record) -> list[Record]:
        """Take a sample; return its set, in the order of the group, once that is complete, and nothing before.

        Raises ValueError if the sample has no header stamp.
        """
        if member not in self.members:
            return []
        stamp = stamp_of(record.sample)
        begun = self._begun.setdefault(stamp, {})
        if member in begun:
            self._on_drop(1)  # two samples of one topic with one stamp: the newer one belongs to the set
        begun[member] = record
        if not self.members <= begun.keys():
            if len(self._begun) > _MOST_BEGUN:
                self._drop(next(iter(self._begun)))  # the one that was begun first: clocks may go back
            return []
        del self._begun[stamp]
        for older in [other for other in self._begun if other < stamp]:
            self._drop(older)
        return [begun[each] for each in sorted(self.members)]

    def _drop(self, stamp: tuple[int, int]) -> None:
        self._on_drop(len(self._begun.pop(stamp)))
