"""The one thread of an end that writes to the link: the paced queue, the end's states, its signs and receipts."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from arpd.endpoint.writing_thread import WritingThread
from arpd.relay.envelope import wrap
from arpd.relay.link_queue import LinkQueue

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.endpoint.lane import Lane
    from arpd.relay.envelope import Chunk


class LinkThread(WritingThread):
    """Writes to the link, and accounts for what arrives from it; nobody else waits for a write.

    Parameters
    ----------
    session : of this process, 32 bit
    state : writes a state of the end, reliably
    sign : writes one sign of life, best effort
    together : writes small messages that leave together, reliably
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        session: int,
        *,
        state: Callable[[bytes], None],
        sign: Callable[[bytes], None],
        together: Callable[[bytes], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link = LinkQueue(session, clock(), together=together)
        super().__init__(self._link, name="arpd-link", clock=clock)
        self._write_state, self._write_sign = state, sign
        self._state: bytes | None = None  # that waits; a newer one takes its place

    def is_sending(self, lane: Lane, source: Hashable) -> bool:
        """Return whether a message of this source is on its way, or was just now."""
        with self._changed:
            return lane.is_sending(source, self._clock())

    def tell(self, state: bytes) -> None:
        """Write a state of the end, before all that waits."""
        with self._changed:
            self._state = state
            self._wake(0.0)

    def follow(self, partner: int) -> None:
        """Take the session of the other end, 0 = there is none."""
        with self._changed:
            if self._link.follow(partner, self._clock()):
                self._wake(0.0)

    def arrived(self, sample: bytes, *, is_together: bool = False) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; `LinkQueue.arrived` says more."""
        with self._changed:
            arrived = self._link.arrived(sample, self._clock(), is_together=is_together)
            self._wake(self._link.sign_s)
        return arrived

    def hear(self, sign: bytes) -> int:
        """Take a sign of life of the other end; `LinkQueue.hear` says more."""
        with self._changed:
            session = self._link.hear(sign, self._clock())
            self._wake(0.0)
        return session

    @property
    def held_s(self) -> float:
        """Time in which something waited for receipts (s)."""
        return self._link.held_s

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self._link.link_bytes

    def _choose(self, now_s: float) -> Callable[[], object] | None:
        if (sign := self._link.take_sign(now_s)) is not None:
            return partial(self._write_sign, wrap(sign))
        if self._state is not None and not self._link.flight.is_out(now_s):
            state, self._state = self._state, None
            return partial(self._write_state, wrap(state))
        act = super()._choose(now_s)
        self._link.note_held(now_s)
        return act

    def _due_s(self, now_s: float) -> float:
        return min(self._link.sign_s, super()._due_s(now_s))
