"""A bottleneck that sends transmissions; each has an overhead and may carry several waiting packets."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.sim.bottleneck import MOST_UNCOUNTED, Bottleneck

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.sim.loss import Losses
    from arpd.sim.service import Service
    from arpd.sim.timeline import Timeline

_MOST_AIR_S = 5.484e-3  # of one transmission: aPPDUMaxTime of IEEE 802.11 (HT and VHT)


@dataclass(kw_only=True, slots=True)
class _Datagram:
    """One datagram; its packets wait in line, are on the air or have arrived.

    Parameters
    ----------
    packet_bytes : size of each packet (bytes)
    in_line : packets that wait
    is_whole : True while all its packets were accepted and none was lost
    """

    packet_bytes: float
    in_line: int
    is_whole: bool
    deliver: Callable[[], object]


class AggregatingBottleneck(Bottleneck):
    """A bottleneck that sends transmissions, with one event for each.

    A transmission carries the packets that wait when it starts, up to ``aggregate_packets`` and up to the longest
    transmission of 802.11. All of them arrive when it ends. An idle link does not wait for more packets.

    Parameters
    ----------
    timeline, service, losses, delay_s, room_bytes : see `Bottleneck`
    overhead_s : time that every transmission takes before its first byte, at any rate (s)
    aggregate_packets : most packets of one transmission
    """

    def __init__(
        self,
        timeline: Timeline,
        service: Service,
        losses: Losses,
        *,
        delay_s: float,
        room_bytes: int,
        overhead_s: float,
        aggregate_packets: int,
    ) -> None:
        super().__init__(timeline, service, losses, delay_s=delay_s, room_bytes=room_bytes)
        self._overhead_s = overhead_s
        self._aggregate_packets = aggregate_packets
        self._line: deque[_Datagram] = deque()
        self._line_bytes = 0.0
        self._line_packets = 0
        self._on_air: list[tuple[_Datagram, int]] = []  # datagram and number of its packets
        self._air_bytes = 0.0
        self._air_served = 0.0  # bytes that the service can have carried when this transmission ends
        self._air_until_s = -math.inf
        self._arriving: deque[tuple[float, float, int]] = deque()  # when, bytes, packets

    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when all of it has arrived or is lost, if no other joins its transmission (s)."""
        accepted = self._admit(wire_bytes, packets, self._room_bytes - self.waiting_bytes())
        if not accepted:
            return self._timeline.now_s
        packet_bytes = wire_bytes / packets
        self._line.append(
            _Datagram(packet_bytes=packet_bytes, in_line=accepted, is_whole=accepted == packets, deliver=deliver)
        )
        self._line_bytes += accepted * packet_bytes
        self._line_packets += accepted
        if not self._on_air:
            self._transmit()
        return self._clear_s() + self._delay_s

    def waiting_bytes(self) -> float:
        """Return the bytes in the queue and on the air."""
        return self._line_bytes + self._unsent_on_air()

    def wait_s(self) -> float:
        """Return the time that a packet put now would wait before it is sent (s)."""
        return self._clear_s() - self._timeline.now_s if self._on_air else 0.0

    def received(self) -> tuple[float, int]:
        """Return the traffic that has reached the far interface (bytes, packets)."""
        while self._arriving and self._arriving[0][0] <= self._timeline.now_s:
            _, received_bytes, received_packets = self._arriving.popleft()
            self._received_bytes += received_bytes
            self._received_packets += received_packets
        return self._received_bytes, self._received_packets

    def _unsent_on_air(self) -> float:
        if not self._on_air:
            return 0.0
        left = self._air_served - self._service.by(self._timeline.now_s)
        return min(self._air_bytes, max(0.0, left))

    def _clear_s(self) -> float:
        """Return the moment at which everything that waits now has been sent (s)."""
        if not self._line_packets:
            return self._air_until_s
        transmissions = -(-self._line_packets // self._aggregate_packets)
        first_byte_s = self._air_until_s + transmissions * self._overhead_s
        if math.isinf(first_byte_s):
            return math.inf
        return self._service.when(self._service.by(first_byte_s) + self._line_bytes)

    def _transmit(self) -> None:
        """Start a transmission with the packets in line."""
        room, size = self._aggregate_packets, 0.0
        most_bytes = _MOST_AIR_S * self._service.rate_at(self._timeline.now_s)
        while room and self._line:
            head = self._line[0]
            taken = min(room, head.in_line, max(0 if size else 1, int((most_bytes - size) // head.packet_bytes)))
            if not taken:
                break
            head.in_line -= taken
            room -= taken
            size += taken * head.packet_bytes
            self._on_air.append((head, taken))
            if not head.in_line:
                self._line.popleft()
        self._line_packets -= self._aggregate_packets - room
        # Rounding of fractions of datagrams would leave a millionth of a byte in an empty line.
        self._line_bytes = self._line_bytes - size if self._line else 0.0
        self._air_bytes = size
        self._air_served = self._service.by(self._timeline.now_s + self._overhead_s) + size
        self._air_until_s = self._service.when(self._air_served)
        if self._air_until_s < math.inf:
            self._timeline.at(self._air_until_s, self._end)

    def _end(self) -> None:
        """End the transmission: its packets arrive, and the next transmission starts."""
        arrival_s = self._air_until_s + self._delay_s
        received_bytes, received_packets = 0.0, 0
        for datagram, packets in self._on_air:
            surviving = self._losses.survivors(packets, arrival_s)
            self.lost_packets += packets - surviving
            received_bytes += surviving * datagram.packet_bytes
            received_packets += surviving
            datagram.is_whole = datagram.is_whole and surviving == packets
            if datagram.is_whole and not datagram.in_line:
                self._timeline.at(arrival_s, datagram.deliver)
        self._arriving.append((arrival_s, received_bytes, received_packets))
        if len(self._arriving) > MOST_UNCOUNTED:
            self.received()
        self._on_air = []
        if self._line:
            self._transmit()
