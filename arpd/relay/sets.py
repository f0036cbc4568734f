"""Sets of samples with one header stamp, which cross the link whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.ros.cdr import stamp_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from arpd.relay.envelope import Record

_MOST_BEGUN, _MOST_BYTES = 64, 16_000_000  # of sets that wait for their last sample


class Sets:
    """Collects the samples of a group of topics into sets.

    A set is complete when each member that is carried has given a sample with its stamp. The samples of one writer
    arrive in order, so a set that is older than a complete one will never be complete, and is dropped. Of those that
    wait for a sample, the first ones are dropped where they are too many, or take too much memory.

    Parameters
    ----------
    members : places in the group of the topics that are carried; they may change
    on_drop : called with the number of samples of a set that was never complete
    """

    def __init__(self, members: Collection[int], *, on_drop: Callable[[int], None]) -> None:
        self.members = frozenset(members)
        self._on_drop = on_drop
        self._begun: dict[tuple[int, int], dict[int, Record]] = {}
        self._bytes = 0  # of their samples

    def add(self, member: int, record: Record) -> list[Record]:
        """Take a sample; return its set, in the order of the group, once that is complete, and nothing before.

        Raises ValueError if the sample has no header stamp.
        """
        if member not in self.members:
            return []
        stamp = stamp_of(record.sample)
        begun = self._begun.setdefault(stamp, {})
        if member in begun:
            self._bytes -= len(begun[member].sample)
            self._on_drop(1)  # two samples of one topic with one stamp: the newer one belongs to the set
        begun[member] = record
        self._bytes += len(record.sample)
        if not self.members <= begun.keys():
            # Two at least, as the samples of a set come one by one. The one that was begun first: clocks may go back.
            while len(self._begun) > (_MOST_BEGUN if self._bytes <= _MOST_BYTES else 2):
                self._drop(next(iter(self._begun)))
            return []
        self._take(stamp)
        for older in [other for other in self._begun if other < stamp]:
            self._drop(older)
        return [begun[each] for each in sorted(self.members)]

    def _take(self, stamp: tuple[int, int]) -> int:
        """Forget a set; return the number of its samples."""
        taken = self._begun.pop(stamp)
        self._bytes -= sum(len(record.sample) for record in taken.values())
        return len(taken)

    def _drop(self, stamp: tuple[int, int]) -> None:
        self._on_drop(self._take(stamp))
