"""The one thread of an end that writes to the link: the paced queue, the end's states, its signs and receipts."""

from __future__ import annotations

import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING

from arpd.endpoint.writing_thread import WritingThread
from arpd.relay.envelope import wrap
from arpd.relay.link_end import LinkEnd

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.endpoint.lane import Lane
    from arpd.relay.envelope import Chunk


class LinkThread(WritingThread):
    """Writes to the link, and accounts for what arrives from it; nobody else waits for a write.

    Parameters
    ----------
    session : of this process, 32 bit
    sign : writes one sign of life, best effort
    together : writes small messages that leave together, reliably
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        session: int,
        *,
        sign: Callable[[bytes], None],
        together: Callable[[bytes], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._end = LinkEnd(session, clock(), together=together)
        super().__init__(self._end.queue, name="arpd-link", clock=clock)
        self._sign = sign
        self._own: deque[Callable[[], None]] = deque(maxlen=1)

    def is_sending(self, lane: Lane, source: Hashable) -> bool:
        """Return whether a message of this source is on its way, or was just now."""
        with self._changed:
            return lane.is_sending(source, self._clock())

    def send(self, write: Callable[[bytes], None], data: bytes) -> None:
        """Write a message of the end itself, before all that waits and in place of an older one."""
        with self._changed:
            self._own.append(partial(write, wrap(data)))
            self._wake(0.0)

    def follow(self, partner: int) -> None:
        """Take the session of the other end."""
        with self._changed:
            if self._end.follow(partner):
                self._wake(0.0)

    def arrived(self, sample: bytes, *, is_together: bool = False) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; `LinkEnd.arrived` says more."""
        with self._changed:
            arrived = self._end.arrived(sample, self._clock(), is_together=is_together)
            self._wake(self._end.sign_s)
        return arrived

    def hear(self, data: bytes) -> int:
        """Take a sign of life of the other end; `LinkEnd.hear` says more."""
        with self._changed:
            session = self._end.hear(data, self._clock())
            self._wake(0.0)
        return session

    @property
    def held_s(self) -> float:
        """Time in which something waited for receipts (s)."""
        return self._end.held_s

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self._end.link_bytes

    def _choose(self, now_s: float) -> Callable[[], object] | None:
        if (sign := self._end.take_sign(now_s)) is not None:
            return partial(self._sign, wrap(sign))
        if self._own and not self._end.is_out(now_s):
            return self._own.popleft()
        act = super()._choose(now_s)
        self._end.note_held(now_s)
        return act

    def _due_s(self, now_s: float) -> float:
        return min(self._end.sign_s, super()._due_s(now_s))
