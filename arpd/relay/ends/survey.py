"""Topics of the local domain that may cross the link, and their writers."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from arpd.relay.ends.offers import WriterOffer

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from arpd.ros.graph import Endpoint, GraphView

_NAMELESS_S = 2.0  # a writer without a node for so long never has one
_REMEMBERED_S = 30.0  # a writer that left
_TOLD_S = 1.0  # a writer that left before a look found it is offered so long: its samples need its name there
_MOST_SOUGHT = 100
_TOLD = ("node", "is_reliable", "is_latched", "deadline_ns", "lifespan_ns", "lease_ns", "is_manual")


class Surveyed:
    """One topic: types and writers of other processes than this one, as they were read last.

    A read replaces whole mappings, because the reading thread and the end's own look at them without a lock.

    Parameters
    ----------
    local : the topic's name there
    """

    def __init__(self, view: GraphView, local: str) -> None:
        self._view, self.local = view, local
        self._lock = threading.Lock()
        self._changes = -1  # of the graph, when it was looked at last
        self.types: tuple[str, ...] = ()
        self.type_name = ""  # type that is offered
        self.type_hash = ""  # its definition, where all its writers tell the same one
        self.writers: tuple[WriterOffer, ...] = ()
        self.known: Mapping[bytes, WriterOffer] = {}  # by GUID, with those that left, whose samples may still come
        self._left_s: dict[bytes, float] = {}
        self.is_waiting = False  # whether to read again though nothing changes: a node may become known, or be told
        self._sought: deque[bytes] = deque(maxlen=_MOST_SOUGHT)  # writers of which a sample came first
        self._unnamed_s: dict[bytes, float] = {}  # writers whose node is not known, and since when

    def look(self, changes: int) -> None:
        """Read what has changed, as the number of changes of the graph tells."""
        before, self._changes = self._changes, changes
        if before != changes or self.is_waiting:
            self._read()

    def writer(self, gid: bytes) -> WriterOffer | None:
        """Return the writer with this GUID, after another look where it is not known; for any thread."""
        if gid not in self.known:
            self._view.look()
            with self._lock:
                if gid not in self._sought:  # the script that wrote it may be gone before the next look
                    self._sought.append(gid)
                    self._view.writers_now(self.local)
            self._read()
        return self.known.get(gid)

    def _read(self) -> None:
        with self._lock:
            ours = self._view.ours
            others = [each for each in self._view.writers(self.local) if each.participant not in ours]
            self.read(others, time.monotonic())

    def read(self, writers: Collection[Endpoint], now_s: float) -> None:
        """Take the writers of the topic, at this time of the monotonic clock."""
        self._unnamed_s = {each.gid: self._unnamed_s.get(each.gid, now_s) for each in writers if not each.is_named}
        waiting = {gid for gid, since_s in self._unnamed_s.items() if now_s - since_s < _NAMELESS_S}
        self.is_waiting = bool(waiting)
        named = [each for each in writers if each.gid not in waiting]
        self.types = tuple(sorted({each.type_name for each in named}))
        if named and self.type_name not in self.types:  # a stray writer of another type stops nothing that flows
            if self.type_name:
                self._sought.clear()  # what has left is of another type
            self.type_name = self.types[0] if len(self.types) == 1 else ""
        offered = [each for each in named if each.type_name == self.type_name]
        hashes = {each.type_hash for each in offered} - {""}
        if named:  # else what has left is offered as it was
            self.type_hash = hashes.pop() if len(hashes) == 1 else ""
        present = {each.gid: _offer(each) for each in sorted(offered, key=lambda each: each.gid)}
        self._left_s = {gid: self._left_s.get(gid, now_s) for gid in self.known.keys() - present}
        left = {gid: self.known[gid] for gid, left_s in self._left_s.items() if now_s - left_s < _REMEMBERED_S}
        self.known = left | present
        brief = [gid for gid in self._sought if gid in left and now_s - self._left_s[gid] < _TOLD_S]
        self.is_waiting |= bool(brief)
        self.writers = (*present.values(), *(left[gid] for gid in brief))


def _offer(found: Endpoint) -> WriterOffer:
    return WriterOffer(gid=found.gid.hex(), **{name: getattr(found, name) for name in _TOLD})
