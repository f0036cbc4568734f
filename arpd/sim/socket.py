"""The socket of a simulated participant: it takes what fits, and makes the writer wait while the queue is full."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from arpd.sim.link import Loopback, SimulatedLink

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.sim.timeline import Timeline

Carrier = SimulatedLink | Loopback  # one direction of a link, or the way within a host
#: Most that one socket has in the interface's queue: Linux counts 2.3 kB for a packet of 1.4 (net.core.wmem_default).
SOCKET_BYTES = 130_000
# Packets that are lost or arrive together: fewer would only make more events.
_AT_ONCE, _MOST_AT_ONCE = 16, 64


@dataclass(slots=True)
class _Datagrams:
    """A sample on its way into the queue.

    Parameters
    ----------
    packet_bytes : wire bytes of one packet
    left : packets that the queue has not taken
    is_again : whether they were sent before
    arrived : called with the number of packets that have arrived together
    settled : called with the moment at which all have arrived or are lost, once it is known (s)
    """

    packet_bytes: float
    left: int
    is_again: bool
    arrived: Callable[[int], None]
    settled: Callable[[float], None]


class Socket:
    """Puts samples onto a link, a part at a time where they do not fit.

    Parameters
    ----------
    room_bytes : most that it has in the queue of the interface; infinite where the bottleneck is further on, so that
        nothing pushes back (bytes)
    on_free : called when it has taken everything, after it was full
    """

    def __init__(
        self, timeline: Timeline, carrier: Carrier, *, room_bytes: float, on_free: Callable[[], None] = lambda: None
    ) -> None:
        self.timeline = timeline
        self.carrier = carrier
        self._room_bytes = room_bytes
        self._on_free = on_free
        self._waiting: deque[_Datagrams] = deque()
        self._inside: deque[tuple[float, float]] = deque()  # when it leaves the queue (s), bytes
        self._inside_bytes = 0.0

    @property
    def is_full(self) -> bool:
        """Whether a write blocks now."""
        return bool(self._waiting)

    def send(
        self,
        wire_bytes: float,
        packets: int,
        *,
        is_again: bool,
        arrived: Callable[[int], None],
        settled: Callable[[float], None],
    ) -> None:
        """Send the packets of a sample.

        Parameters
        ----------
        wire_bytes : bytes of all of them, headers included
        is_again, arrived, settled : as `_Datagrams` explains
        """
        self._waiting.append(_Datagrams(wire_bytes / packets, packets, is_again, arrived, settled))
        if len(self._waiting) == 1:
            self._push()

    def _push(self) -> None:
        now_s = self.timeline.now_s
        while self._inside and self._inside[0][0] <= now_s:
            self._inside_bytes -= self._inside.popleft()[1]
        while self._waiting:
            first = self._waiting[0]
            room = self._room_bytes - self._inside_bytes
            fits = first.left
            if first.is_again or first.left > _MOST_AT_ONCE or first.left * first.packet_bytes > room:
                fits = 1 if first.is_again else min(first.left, _AT_ONCE)
                if fits * first.packet_bytes > room and self._inside:
                    self.timeline.at(self._inside[0][0], self._go_on)
                    return
            size = fits * first.packet_bytes
            left_s = self.carrier.send(size, fits, partial(first.arrived, fits))
            self._inside.append((left_s, size))
            self._inside_bytes += size
            first.left -= fits
            if not first.left:
                self._waiting.popleft()
                first.settled(left_s)

    def _go_on(self) -> None:
        self._push()
        if not self._waiting:
            self._on_free()
