"""What is on its way across the link, as the other end's receipts tell: pure."""

from __future__ import annotations

import math
import struct
from collections import deque
from typing import NamedTuple

from arpd.relay.envelope import WRAP

_OUT_S = 0.4  # of silence, beyond the usual time of a receipt, while something is on its way
# Time of the capacity that may be on its way, beyond the fastest receipt of late. More would only wait, and what the
# socket's buffer does not hold, 50 ms of 20 Mbit/s with Linux' defaults, is lost there.
_WINDOW_S = 0.02
_REPAIR_S = 0.04  # more where packets are lost: no receipt tells of what has arrived behind one that must come again
_SMALL_WINDOWS = 3.0  # for small messages: what fits the link must not wait for what fills it
_QUEUED_S = 0.08  # an age that shows a queue on the link; what arrives is then what the link carries
_STANDING_S = 0.1  # a queue that stays as long as this
_TARGET_S, _RELIEF_S = 0.015, 0.1  # a queue up to the first may stay; at one longer by the second nothing would leave
_LEAST_RELIEF, _MOST_RELIEF = 0.5, 1.15  # the second where no queue stands: the headroom is for what nobody sees
_GROWTH = 1.5  # times the best rate of late: a daemon may believe more than the link carries
_LEAST_BYTES = 12_000
_RATE_S, _BEST_S = 0.2, 1.0
_TRIP_S = 10.0
# Time in which a receipt was held up on its way back, lately and at most, as by a radio that saves power: what has
# arrived meanwhile is not on its way.
_BACK_S, _MOST_BACK_S = 0.5, 0.1
_PROMPT_S, _PROMPT_BYTES = 0.008, 8_000  # a receipt for so many bytes follows so soon
_LAZY_S = 0.1  # and one for fewer
_OFFSET_S = 30.0
# Freight of which something is missing for so long does not arrive, and then the next one waits at first so long.
_STUCK_S, _HOLD_S, _MOST_HOLD_S = 0.3, 60.0, 3600.0
_HALF = WRAP // 2
_SIGN = struct.Struct("<BIIIIIIII")
_VERSION = 3
SIGN_BYTES = _SIGN.size


class Receipt(NamedTuple):
    """What one end has received of the other's chunks, all modulo `WRAP`.

    Parameters
    ----------
    session : of the end whose chunks these are, 0 = none has come yet
    number : highest of the chunks
    age_us : age of that chunk (µs)
    received : bytes of all chunks
    at_us : when, by the receiver's clock (µs)
    """

    session: int = 0
    number: int = 0
    age_us: int = 0
    received: int = 0
    at_us: int = 0


class Sign(NamedTuple):
    """Sign of life of one end, with its receipt for the other's chunks.

    Parameters
    ----------
    session : of the sender
    number : of a probe, which the other end answers with a receipt; counted as chunks are, 0 = this is none
    departed_us : when it left, by the sender's clock, modulo `WRAP` (µs)
    """

    session: int
    number: int = 0
    departed_us: int = 0
    receipt: Receipt = Receipt()


def encode_sign(sign: Sign) -> bytes:
    """Return a sign as bytes."""
    return _SIGN.pack(_VERSION, *sign[:3], *sign.receipt)


def decode_sign(data: bytes) -> Sign:
    """Return the sign from its bytes; raises ValueError if they are none of this version."""
    if len(data) != SIGN_BYTES or data[0] != _VERSION:
        raise ValueError("no sign of life of this version; install one arpd on both ends")
    _, session, number, departed_us, *receipt = _SIGN.unpack(data)
    return Sign(session, number, departed_us, Receipt(*receipt))


class _Lowest:
    """Lowest value of the last ``span_s`` to twice that."""

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._since_s = -math.inf
        self._before = self._now = math.inf

    def note(self, value: float, now_s: float) -> float:
        """Take a value; return the lowest."""
        if now_s - self._since_s > self._span_s:
            self._since_s, self._before, self._now = now_s, self._now, math.inf
        self._now = min(self._now, value)
        return min(self._before, self._now)


class Received:
    """Keeps account of the other end's chunks, for its receipts.

    Attributes
    ----------
    expects_s : when the next receipt is due if as much comes as before; -inf = nobody knows (s)
    """

    def __init__(self) -> None:
        self._receipt = Receipt()
        self._offsets = _Lowest(_OFFSET_S)
        self._epoch_us = 0
        self._noted_s = -math.inf  # when a chunk came last
        self._told = Receipt()
        self._told_s = self.expects_s = -math.inf

    def note(self, session: int, number: int, departed_us: int, size: int, now_s: float) -> float:
        """Take a chunk; return its age: how much longer than the fastest of late it was on its way (s).

        The time may be of another clock than elsewhere here, which goes on while this host sleeps.
        """
        now_us, self._noted_s = int(now_s * 1e6), now_s
        if session != self._receipt.session:
            self._receipt, self._offsets = Receipt(session=session), _Lowest(_OFFSET_S)
            self._told, self._epoch_us = Receipt(session=session), now_us - departed_us
        age_us = self._age_us(departed_us, now_s)
        last = self._receipt
        is_newer = last.at_us == 0 or 0 < (number - last.number) % WRAP < _HALF
        self._receipt = Receipt(
            session=session,
            number=number if is_newer else last.number,
            age_us=int(age_us) if is_newer else last.age_us,
            received=(last.received + size) % WRAP,
            at_us=now_us % WRAP or 1,
        )
        return age_us / 1e6

    def hear(self, session: int, departed_us: int, now_s: float) -> None:
        """Take a sign of life, for the ages after a pause: in a night two clocks part by seconds.

        While chunks come they alone count, because a sign takes less time on a slow link.
        """
        if session == self._receipt.session and now_s - self._noted_s > _OFFSET_S:
            self._age_us(departed_us, now_s)

    def _age_us(self, departed_us: int, now_s: float) -> float:
        # The clocks of the two hosts have nothing in common, so only differences of this difference count.
        took_us = (int(now_s * 1e6) - departed_us - self._epoch_us + _HALF) % WRAP - _HALF
        return took_us - self._offsets.note(took_us, now_s)

    def due_s(self) -> float:
        """Return when to send a receipt (s); ``inf`` when the last one says all."""
        unsaid = (self._receipt.received - self._told.received) % WRAP
        if unsaid == 0:
            return math.inf
        return self._told_s + (_PROMPT_S if unsaid >= _PROMPT_BYTES else _LAZY_S)

    def take(self, now_s: float) -> Receipt:
        """Return the receipt, which then counts as sent."""
        is_quick = (self._receipt.received - self._told.received) % WRAP >= _PROMPT_BYTES
        self._told, self._told_s = self._receipt, now_s
        self.expects_s = now_s + _PROMPT_S if is_quick else -math.inf
        return self._receipt


class _Sent(NamedTuple):
    number: int
    wire_bytes: int
    at_s: float
    counted: int


class Freight:
    """Tells whether datagrams of several packets arrive.

    Some networks drop what IP has cut, and a kernel that is full of halves drops all of it.

    Attributes
    ----------
    held_until_s : until then none should leave (s)
    """

    def __init__(self) -> None:
        self.held_until_s = self._sent_s = -math.inf
        self._hold_s = _HOLD_S
        self._missing = _Lowest(_STUCK_S)
        self._lost = 0.0  # bytes that are missing for good

    def send(self, now_s: float) -> None:
        """Note that one leaves."""
        self._sent_s = now_s

    def note_missing(self, missing: int, now_s: float) -> None:
        """Take the bytes that are missing before the highest chunk that has arrived."""
        least = self._missing.note(missing, now_s)
        if now_s < self.held_until_s or now_s - self._sent_s > 2.0 * _STUCK_S or least < self._lost:
            self._lost = least
        elif least > self._lost:
            is_soon = now_s - self.held_until_s < self._hold_s
            self._hold_s = min(2.0 * self._hold_s, _MOST_HOLD_S) if is_soon else _HOLD_S
            self.held_until_s = now_s + self._hold_s


class Flight:
    """Bounds what is on its way unconfirmed, and notices when the link is out.

    Each sample asks several times for both, and little but a receipt changes them.

    Attributes
    ----------
    window_bytes : most that may be on its way
    out_s : when the link is out: something is on its way, and no receipt has come for a while; else ``inf`` (s)
    """

    def __init__(self) -> None:
        self._capacity = math.inf
        self._repair_s = 0.0
        self._number = 0
        self.freight = Freight()
        self._progress_s = -math.inf
        self._trips = _Lowest(_TRIP_S)
        self._trip_s = 0.0
        self._back_s = 0.0  # so much longer than the fastest one a receipt of late was on its way back
        self._slowest = _Lowest(_BACK_S)  # trip, negative
        self._standing_s = 0.0
        self._queues = _Lowest(_STANDING_S)
        self._bests: deque[tuple[float, float]] = deque()  # time and rate
        self.restart()

    def restart(self) -> None:
        """Forget what was sent to a process that is gone."""
        self._sent: deque[_Sent] = deque()
        self._bytes = self._counted = 0
        self._arrivals: deque[tuple[int, int]] = deque()  # time at the receiver (µs) and bytes until then
        self._queue_s = 0.0
        self._rate = 0.0  # at which chunks arrive (bytes/s)
        self._bound()

    def believe(self, capacity: float, *, is_lossy: bool) -> None:
        """Take what the link carries, ``inf`` = unknown (bytes/s), and whether it loses packets."""
        self._capacity, self._repair_s = capacity, _REPAIR_S if is_lossy else 0.0
        self._bound()

    def send(self, wire_bytes: int, now_s: float, *, size: int, is_freight: bool = False) -> int:
        """Count a chunk that leaves now; return its number.

        Parameters
        ----------
        size : what the other end's receipts count of it (bytes)
        is_freight : whether it is one datagram of several packets
        """
        self._number = (self._number + 1) % WRAP
        self._counted = (self._counted + size) % WRAP
        if is_freight:
            self.freight.send(now_s)
        if not self._sent:
            self.out_s = now_s + _OUT_S + self._trip_s
        self._sent.append(_Sent(self._number, wire_bytes, now_s, self._counted))
        self._bytes += wire_bytes
        return self._number

    def confirm(self, receipt: Receipt, now_s: float) -> None:
        """Take a receipt of the other end."""
        confirmed, before = None, self._bytes
        # A chunk that DDS still repeats counts as arrived once a later one has: it takes no room on the link now.
        while self._sent and (receipt.number - self._sent[0].number) % WRAP < _HALF:
            confirmed = self._sent.popleft()
            self._bytes -= confirmed.wire_bytes
        if confirmed is None:
            return
        self.freight.note_missing((confirmed.counted - receipt.received + _HALF) % WRAP - _HALF, now_s)
        self._progress_s = now_s
        self._queue_s = receipt.age_us / 1e6
        took_s = max(0.0, now_s - confirmed.at_s - self._queue_s)
        self._trip_s = self._trips.note(took_s, now_s)
        is_prompt = before - self._bytes >= _PROMPT_BYTES  # one for fewer waits before it leaves
        slowest_s = -self._slowest.note(-took_s if is_prompt else 0.0, now_s)
        self._back_s = min(_MOST_BACK_S, max(0.0, slowest_s - self._trip_s - _PROMPT_S))
        self._standing_s = self._queues.note(self._queue_s, now_s)
        if self._arrivals and (receipt.received - self._arrivals[-1][1]) % WRAP > _HALF:
            self._arrivals.clear()  # another receiver counts
        self._arrivals.append((receipt.at_us, receipt.received))
        span_us = (receipt.at_us - self._arrivals[0][0]) % WRAP
        if self._queue_s > _QUEUED_S:
            self._bests.clear()  # the link carries less than it did
        if span_us > 2e4:
            self._rate = (receipt.received - self._arrivals[0][1]) % WRAP / span_us * 1e6
            self._bests.append((now_s, self._rate))
        while (receipt.at_us - self._arrivals[0][0]) % WRAP > _RATE_S * 1e6:
            self._arrivals.popleft()
        while self._bests and now_s - self._bests[0][0] > _BEST_S:
            self._bests.popleft()
        self._bound()

    @property
    def relief(self) -> float:
        """Times its share that the queue drains: less than once while a queue stands on the link."""
        return min(_MOST_RELIEF, max(_LEAST_RELIEF, 1.0 - (self._standing_s - _TARGET_S) / _RELIEF_S))

    def has_room(self, *, is_small: bool) -> bool:
        """Return whether one more chunk may leave; a small message may where a large one has to wait."""
        return self._bytes < (_SMALL_WINDOWS if is_small else 1.0) * self.window_bytes

    def _bound(self) -> None:
        self.out_s = max(self._progress_s, self._sent[0].at_s) + _OUT_S + self._trip_s if self._sent else math.inf
        rate = min(self._capacity, _GROWTH * max((rate for _, rate in self._bests), default=0.0))
        if self._queue_s > _QUEUED_S:
            rate = min(rate, self._rate)
        unconfirmed_s = _WINDOW_S + self._repair_s + self._trip_s + self._back_s
        self.window_bytes = max(_LEAST_BYTES, unconfirmed_s * rate)
