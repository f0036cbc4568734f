"""What one end of a relay sends over the link, and what it knows of the other end: pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.endpoint.lane import Lane
from arpd.model.wire import wire_size
from arpd.relay.envelope import WRAP, decode_chunk
from arpd.relay.flight import Flight, Received
from arpd.relay.link_queue import LinkQueue
from arpd.relay.partner import EVERY_S
from arpd.relay.signs import SIGN_BYTES, Sign, decode_sign, encode_sign

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.relay.envelope import Chunk

_PROBE_S, _PROMPT_S = 0.1, 30.0  # a probe while the link is out, and how long they come so often


class LinkEnd:
    """The paced queue of an end, its signs of life and receipts, and what has arrived from the other end.

    Parameters
    ----------
    session : of this process, 32 bit
    now_s : when it begins (s)
    together : writes small messages that leave together; None = each leaves alone

    Attributes
    ----------
    queue : what waits to cross the link
    held_s : time in which something waited for receipts: the link takes no more (s)
    """

    def __init__(self, session: int, now_s: float, *, together: Callable[[bytes], None] | None = None) -> None:
        self._session = session
        self._flight = Flight()
        self._received = Received()
        self.queue = LinkQueue(session, self._flight, None if together is None else Lane(together))
        self._sign_s = self._probe_s = now_s
        self._partner = 0  # session of the other end
        self._received_bytes = 0.0  # on the link
        self._is_answering = False  # a probe wants its receipt
        self._held_since_s: float | None = None
        self.held_s = 0.0

    def take_sign(self, now_s: float) -> bytes | None:
        """Return the sign of life that leaves now, None if none is due."""
        is_probing = self._flight.is_out(now_s) and now_s >= self._probe_s
        if not (self._is_answering or is_probing or now_s >= min(self._sign_s, self._received.due_s())):
            return None
        self._is_answering = False
        self._sign_s = now_s + EVERY_S
        number = departed_us = 0
        if is_probing:
            is_short = now_s - self._flight.out_s < _PROMPT_S
            self._probe_s = now_s + (_PROBE_S if is_short else EVERY_S)
            number, departed_us = self._flight.send(SIGN_BYTES, now_s), int(now_s * 1e6) % WRAP
        return encode_sign(Sign(self._session, number, departed_us, self._received.take(now_s)))

    @property
    def sign_s(self) -> float:
        """When `take_sign` may have something, or the link is out, unless a receipt comes before (s)."""
        return min(self._sign_s, self._received.due_s(), max(self._flight.out_s, self._probe_s))

    def is_out(self, now_s: float) -> bool:
        """Return whether the link is out."""
        return self._flight.is_out(now_s)

    def note_held(self, now_s: float) -> None:
        """Count the time in which something waits for receipts; called whenever that may change."""
        if self._held_since_s is not None:
            self.held_s += now_s - self._held_since_s
        self._held_since_s = now_s if self.queue.is_held_up else None

    def follow(self, partner: int) -> bool:
        """Take the session of the other end; return whether it is new, and knows nothing of what was sent before."""
        if partner == self._partner:
            return False
        self._partner = partner
        self._flight.restart()
        return True

    def arrived(self, sample: bytes, now_s: float, *, is_together: bool = False) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; return it, and its age (s).

        Parameters
        ----------
        is_together : whether it holds small messages, whose writer asks seldom for an acknowledgement

        Raises
        ------
        ValueError
            If the sample holds no chunk.
        """
        chunk, size = decode_chunk(sample), len(sample)
        self._received_bytes += wire_size(size, rate_hz=math.inf if chunk.offset or is_together else 0.0)[0]
        return chunk, self._received.note(chunk.session, chunk.number, chunk.departed_us, size, now_s)

    def hear(self, data: bytes, now_s: float) -> int:
        """Take a sign of life of the other end; return its session.

        Raises
        ------
        ValueError
            If the bytes are none.
        """
        sign = decode_sign(data)
        if sign.receipt.session == self._session:
            self._flight.confirm(sign.receipt, now_s)
        if sign.number:
            self._received.note(sign.session, sign.number, sign.departed_us, SIGN_BYTES, now_s)
            self._is_answering = True
        return sign.session

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self.queue.sent_bytes + int(self._received_bytes)
