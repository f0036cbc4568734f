"""The one thread of an end that writes to the link: the paced queue, the end's states, its signs and receipts."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from arpd.adapters.ros.ends.raw_reader import InvalidHandle
from arpd.apply.relay.envelope import WRAP, decode_chunk, wrap
from arpd.apply.relay.flight import Flight, Received
from arpd.apply.relay.partner import EVERY_S
from arpd.apply.relay.queue import PacedQueue
from arpd.apply.relay.signs import SIGN_BYTES, Sign, decode_sign, encode_sign
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from arpd.apply.relay.envelope import Chunk
    from arpd.apply.relay.lane import Lane
    from arpd.model.plan import TopicPlan
    from arpd.model.price import Price

log = logging.getLogger(__name__)
_PROBE_S, _PROMPT_S = 0.1, 30.0  # a probe while the link is out, and how long they come so often
_IDLE_S = 1.0  # most between two turns, for the watchdog


class LinkThread:
    """Writes to the link, and accounts for what arrives from it; nobody else waits for a write.

    Parameters
    ----------
    session : of this process, 32 bit
    sign : writes one sign of life, best effort
    clock : monotonic clock (s)
    """

    def __init__(
        self, session: int, *, sign: Callable[[bytes], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._session = session
        self._sign = sign
        self._clock = clock
        self._flight = Flight()
        self._received = Received()
        self._queue = PacedQueue(session, self._flight)
        self._own: deque[Callable[[], None]] = deque()
        self._changed = threading.Condition()  # guards all of these
        self._sign_s = self._probe_s = clock()
        self._partner = 0  # session of the other end
        self._received_bytes = 0.0  # on the link
        self._is_answering = False  # a probe wants its receipt
        self._is_stopping = False
        self._next_s = 0.0  # when the thread wakes
        self._held_since_s: float | None = None
        self.held_s = 0.0  # time in which something waited for receipts: the link takes no more
        self.finished_s = clock()
        self._thread = threading.Thread(target=self._run, name="arpd-link", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; what waits is lost."""
        with self._changed:
            self._is_stopping = True
            self._changed.notify()
        self._thread.join(timeout=1.0)

    # -- what leaves

    def add(self, lane: Lane) -> None:
        """Serve a lane from now on."""
        with self._changed:
            self._queue.add(lane)

    def remove(self, lane: Lane) -> None:
        """Serve it no more."""
        with self._changed:
            self._queue.remove(lane)

    def retune(self, lane: Lane, plan: TopicPlan | None, price: Price | None) -> None:
        """Give a lane its plan and the price; None = there is none."""
        with self._changed:
            self._queue.retune(lane, plan, price)
            self._wake(self._queue.due_s(self._clock()))

    def offer(self, lane: Lane, message: bytes, *, source: Hashable = None, lifespan_ns: int = 0) -> None:
        """Let a message wait for its turn.

        Parameters
        ----------
        source : its writer
        lifespan_ns : LIFESPAN of that, 0 = infinite (ns)
        """
        now_s = self._clock()
        expires_s = now_s + lifespan_ns / 1e9 if lifespan_ns else math.inf
        with self._changed:
            self._queue.offer(lane, message, now_s, source=source, expires_s=expires_s)
            self._wake(self._queue.due_s(now_s))

    def is_sending(self, lane: Lane, source: Hashable) -> bool:
        """Return whether a message of this source is on its way, or was just now."""
        with self._changed:
            return lane.is_sending(source, self._clock())

    def send(self, write: Callable[[bytes], None], data: bytes) -> None:
        """Write a message of the end itself, before all that waits."""
        sample = wrap(data)
        with self._changed:
            self._own.append(lambda: write(sample))
            self._wake(0.0)

    # -- what arrives

    def follow(self, partner: int) -> None:
        """Take the session of the other end; a new one knows nothing of what was sent before."""
        with self._changed:
            if partner != self._partner:
                self._partner = partner
                self._flight.restart()
                self._wake(0.0)

    def arrived(self, sample: bytes) -> tuple[Chunk, float]:
        """Account for a chunk of the other end; return it, and its age (s).

        Raises
        ------
        ValueError
            If the sample holds no chunk.
        """
        chunk, size = decode_chunk(sample), len(sample)
        with self._changed:
            self._received_bytes += wire_size(size, rate_hz=math.inf if chunk.offset else 0.0)[0]
            age_s = self._received.note(chunk.session, chunk.number, chunk.departed_us, size, self._clock())
            self._wake(self._received.due_s())
        return chunk, age_s

    def hear(self, data: bytes) -> int:
        """Take a sign of life of the other end; return its session.

        Raises
        ------
        ValueError
            If the bytes are none.
        """
        sign = decode_sign(data)
        now_s = self._clock()
        with self._changed:
            if sign.receipt.session == self._session:
                self._flight.confirm(sign.receipt, now_s)
            if sign.number:
                self._received.note(sign.session, sign.number, sign.departed_us, SIGN_BYTES, now_s)
                self._is_answering = True
            self._wake(0.0)
        return sign.session

    @property
    def link_bytes(self) -> int:
        """What both ends' chunks took of the link."""
        return self._queue.sent_bytes + int(self._received_bytes)

    # -- the thread

    def _wake(self, by_s: float) -> None:
        if by_s < self._next_s:
            self._next_s = by_s
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._is_stopping:
                    return
                write = self._choose()
                self._note_held(self._clock())
                if write is None:
                    now_s = self.finished_s = self._clock()
                    self._next_s = self._due_s(now_s)
                    if self._next_s > now_s:
                        self._changed.wait(self._next_s - now_s)
                    self._next_s = 0.0  # nobody need wake a thread that is awake
                    continue
            try:
                write()
            except InvalidHandle:
                continue  # its topic was just dropped
            except Exception:
                log.exception("a write to the link failed; the next one follows")
            self.finished_s = self._clock()

    def _choose(self) -> Callable[[], None] | None:
        """Return what to write now, None if nothing is due."""
        now_s = self._clock()
        is_probing = self._flight.is_out(now_s) and now_s >= self._probe_s
        if self._is_answering or is_probing or now_s >= min(self._sign_s, self._received.due_s()):
            self._is_answering = False
            self._sign_s = now_s + EVERY_S
            number = departed_us = 0
            if is_probing:
                is_short = now_s - self._flight.out_s < _PROMPT_S
                self._probe_s = now_s + (_PROBE_S if is_short else EVERY_S)
                number, departed_us = self._flight.send(SIGN_BYTES, now_s), int(now_s * 1e6) % WRAP
            sign = wrap(encode_sign(Sign(self._session, number, departed_us, self._received.take(now_s))))
            return lambda: self._sign(sign)
        if self._own and not self._flight.is_out(now_s):
            return self._own.popleft()
        if (ready := self._queue.take(now_s)) is not None:
            return lambda: ready.lane.write(ready.sample)
        return None

    def _note_held(self, now_s: float) -> None:
        if self._held_since_s is not None:
            self.held_s += now_s - self._held_since_s
        self._held_since_s = now_s if self._queue.is_held_up else None

    def _due_s(self, now_s: float) -> float:
        due_s = min(now_s + _IDLE_S, self._sign_s, self._received.due_s(), self._queue.due_s(now_s))
        return min(due_s, max(self._flight.out_s, self._probe_s))
