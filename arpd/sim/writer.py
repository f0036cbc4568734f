"""A reliable DDS writer and its reader in virtual time."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from arpd.model.wire import ACKNACK_BYTES, HEARTBEAT_BYTES, datagram_size, wire_size

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.endpoints import WriterQos
    from arpd.sim.socket import Carrier, Socket

    Take = Callable[[bytes], None]

# Fast DDS resends at every ACKNACK, even samples that wait in the queue. This writer resends a sample once in this time
# and never while it is on its way, so the robot without arpd looks better here than in reality.
_RESEND_S = 0.1
_MOST_ASKED = 256  # most numbers in one ACKNACK (RTPS 2.3, §9.4.2.6)


class _Reader:
    """A reliable reader of one writer: delivers samples in order and skips those that the writer no longer has.

    As in Fast DDS 2.14 (StatefulReader, WriterProxy), the reader delivers the next sample at once. Later samples wait
    until the gap is filled or a heartbeat says that the missing samples are gone.
    """

    def __init__(self, deliver: Take, arrive: Take) -> None:
        self._deliver, self._arrive = deliver, arrive
        self._held: dict[int, bytes] = {}  # samples behind a gap
        self._highest = 0
        self.next = 1

    def on_data(self, number: int, sample: bytes) -> None:
        if number < self.next or number in self._held:
            return
        self._arrive(sample)
        if number > self.next:
            self._held[number] = sample
            return
        self._deliver(sample)
        self.next += 1
        if self._held:
            self._release()

    def on_heartbeat(self, first: int, last: int) -> list[int]:
        """Return the numbers to request again, lowest first."""
        self._highest = max(self._highest, last)
        if first > self.next:
            for number in sorted(number for number in self._held if number < first):
                self._deliver(self._held.pop(number))
            self.next = first
            self._release()
        if self._highest < self.next:
            return []
        most = min(self._highest, self.next + _MOST_ASKED - 1)
        return [number for number in range(self.next, most + 1) if number not in self._held]

    def _release(self) -> None:
        while self.next in self._held:
            self._deliver(self._held.pop(self.next))
            self.next += 1


class SimulatedWriter:
    """A RELIABLE KEEP_LAST `Writer` with one reader; resends requested samples that its history still holds.

    As in Fast DDS, a sample that fills the history carries a heartbeat; a periodic heartbeat serves the others.

    Parameters
    ----------
    socket : of the participant; there samples wait while the queue is full
    back : way of the acknowledgements
    deliver : takes each sample that the application receives
    arrive : takes each sample from the wire; the middleware may hold it back until older ones arrive
    qos : depth (samples); the deadline changes nothing here
    heartbeat_s : period of the heartbeat while a sample is unacknowledged (s)
    is_freight : whether each sample is one datagram, of which no part arrives alone
    """

    def __init__(
        self,
        socket: Socket,
        back: Carrier,
        deliver: Take,
        *,
        arrive: Take = lambda _sample: None,
        qos: WriterQos,
        heartbeat_s: float,
        is_freight: bool = False,
    ) -> None:
        self._is_freight = is_freight
        self._timeline, self._there, self._back = socket.timeline, socket.carrier, back
        self._socket = socket
        self._depth = qos.depth
        self._heartbeat_s = heartbeat_s
        self._reader = _Reader(deliver, arrive)
        self._history: dict[int, bytes] = {}
        self._settled_at_s: dict[int, float] = {}  # when all that was sent of a sample has arrived or is lost
        self._missing: dict[int, int] = {}  # packets of a sample that have not arrived
        self._first, self._last = 1, 0
        self._acknowledged = 0
        self._is_alive = True
        self._is_beating = False

    def publish(self, sample: bytes) -> None:
        """Write one sample; a full history drops its oldest sample, acknowledged or not."""
        self._last += 1
        self._history[self._last] = sample
        if len(self._history) > self._depth:
            del self._history[self._first], self._settled_at_s[self._first]
            self._first += 1
        self._send(self._last)
        if not self._is_beating:
            self._is_beating = True
            self._timeline.at(self._timeline.now_s + self._heartbeat_s, self._beat)

    def matched(self) -> int:
        """Return 1, at once, because a new writer's endpoint data arrives before its samples."""
        return 1

    def readers_acknowledge(self) -> bool:
        """Return True, because the simulated reader is reliable."""
        return True

    def disconnects_readers(self) -> bool:
        """Return False, because no simulated reader requests a deadline."""
        return False

    def is_acknowledged(self) -> bool:
        """Return whether the reader has every sample."""
        return self._acknowledged >= self._last

    def deadlines_missed(self) -> int:
        """Return 0, because nothing that is simulated looks."""
        return 0

    def destroy(self) -> None:
        """Stop resending; samples on the link still arrive."""
        self._is_alive = False
        self._first = self._last + 1
        self._history.clear()
        self._settled_at_s.clear()

    def _send(self, number: int) -> None:
        """Send what is missing of a sample."""
        asked = (self._first, self._last) if len(self._history) >= self._depth else None
        is_again = number in self._missing
        size = len(self._history[number])
        wire_bytes, all_packets = datagram_size(size) if self._is_freight else wire_size(size, rate_hz=math.inf)
        if self._is_freight:
            self._missing[number] = all_packets
        packets = self._missing.setdefault(number, all_packets)
        self._settled_at_s[number] = math.inf
        self._socket.send(
            wire_bytes * packets / all_packets,
            packets,
            is_again=is_again,
            arrived=partial(self._arrive, number, self._history[number], asked),
            settled=partial(self._settle, number),
        )

    def _settle(self, number: int, at_s: float) -> None:
        if number in self._settled_at_s:
            self._settled_at_s[number] = at_s

    def _beat(self) -> None:
        if not self._is_alive or self.is_acknowledged():
            self._is_beating = False
            return
        self._there.send(HEARTBEAT_BYTES, 1, partial(self._acknowledge, self._first, self._last))
        self._timeline.at(self._timeline.now_s + self._heartbeat_s, self._beat)

    # -- at the reader

    def _arrive(self, number: int, sample: bytes, asked: tuple[int, int] | None, packets: int) -> None:
        self._missing[number] = self._missing.get(number, 0) - packets
        if self._missing[number] > 0:
            return
        del self._missing[number]
        self._reader.on_data(number, sample)
        if asked is not None:
            self._acknowledge(*asked)

    def _acknowledge(self, first: int, last: int) -> None:
        missing = self._reader.on_heartbeat(first, last)
        self._back.send(ACKNACK_BYTES, 1, partial(self._on_acknack, self._reader.next - 1, missing))

    # -- back at the writer

    def _on_acknack(self, acknowledged: int, missing: list[int]) -> None:
        self._acknowledged = max(self._acknowledged, acknowledged)
        now_s = self._timeline.now_s
        for number in missing:
            if number in self._history and now_s - self._settled_at_s[number] >= _RESEND_S:
                self._send(number)
