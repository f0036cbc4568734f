"""The bottleneck of a simulated link: a queue with tail drop, and a propagation delay behind it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.sim.loss import Losses
    from arpd.sim.service import Service
    from arpd.sim.timeline import Timeline

# Arrivals are counted when they are asked for, which may take an hour, or when there may be so many.
MOST_UNCOUNTED = 1000


class Bottleneck(ABC):
    """Queues, serves, delivers and counts datagrams.

    Parameters
    ----------
    timeline : virtual time
    service : rate
    losses : decides which packets arrive
    delay_s : propagation delay (s)
    room_bytes : most bytes that it holds, those in service included (bytes)

    Attributes
    ----------
    accepted_bytes, accepted_packets : accepted into the queue
    dropped_packets : dropped because the queue was full
    lost_packets : sent but lost
    """

    def __init__(
        self, timeline: Timeline, service: Service, losses: Losses, *, delay_s: float, room_bytes: int
    ) -> None:
        self._timeline = timeline
        self._service = service
        self._losses = losses
        self._delay_s = delay_s
        self._room_bytes = room_bytes
        self._received_bytes = 0.0
        self._received_packets = 0
        self.accepted_bytes = 0.0
        self.accepted_packets = 0
        self.dropped_packets = 0
        self.lost_packets = 0

    @abstractmethod
    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when all of it has arrived or is lost, as far as this is known (s)."""

    @abstractmethod
    def waiting_bytes(self) -> float:
        """Return the bytes in the queue and in service."""

    @abstractmethod
    def wait_s(self) -> float:
        """Return the time that a packet put now would wait before it is served (s)."""

    @abstractmethod
    def received(self) -> tuple[float, int]:
        """Return the traffic that has reached the far interface (bytes, packets)."""

    def _admit(self, wire_bytes: float, packets: int, room_bytes: float) -> int:
        """Accept the packets of a datagram that fit, drop the others, and count both."""
        packet_bytes = wire_bytes / packets
        accepted = packets if wire_bytes <= room_bytes else max(0, int(room_bytes // packet_bytes))
        self.dropped_packets += packets - accepted
        self.accepted_bytes += accepted * packet_bytes
        self.accepted_packets += accepted
        return accepted


class FluidBottleneck(Bottleneck):
    """A bottleneck that serves one byte after the other.

    It needs no event per packet. It is never idle while it holds something, so a datagram leaves when the backlog
    before it and the datagram itself have been served, and that moment is known at once.
    """

    def __init__(
        self, timeline: Timeline, service: Service, losses: Losses, *, delay_s: float, room_bytes: int
    ) -> None:
        super().__init__(timeline, service, losses, delay_s=delay_s, room_bytes=room_bytes)
        self._busy_until = service.by(timeline.now_s)
        self._crossings: deque[tuple[float, float, float, int]] = deque()  # service start and end, bytes, packets

    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when all of it has arrived or is lost (s)."""
        now_s = self._timeline.now_s
        start = self._service.by(now_s)
        room: float = self._room_bytes
        if self._busy_until > start:
            room -= self._busy_until - start
            start = self._busy_until
        accepted = self._admit(wire_bytes, packets, room)
        if not accepted:
            return now_s
        fragment = wire_bytes / packets
        self._busy_until = end = start + accepted * fragment
        arrival_s = self._service.when(end) + self._delay_s
        surviving = accepted if self._losses.is_lossless else self._losses.survivors(accepted, arrival_s)
        self._crossings.append((start, end, surviving * fragment, surviving))
        if len(self._crossings) > MOST_UNCOUNTED:
            self.received()
        if surviving == packets:
            self._timeline.at(arrival_s, deliver)
        else:
            self.lost_packets += accepted - surviving
        return arrival_s

    def waiting_bytes(self) -> float:
        """Return the bytes in the queue and in service."""
        return max(0.0, self._busy_until - self._service.by(self._timeline.now_s))

    def wait_s(self) -> float:
        """Return the time that a packet put now would wait (s)."""
        return self._service.when(self._busy_until) - self._timeline.now_s if self.waiting_bytes() > 0 else 0.0

    def received(self) -> tuple[float, int]:
        """Return the traffic that has reached the far interface, part of a datagram included (bytes, packets)."""
        served = self._service.by(self._timeline.now_s - self._delay_s)
        crossings = self._crossings
        while crossings and crossings[0][1] <= served:
            _, _, received_bytes, received_packets = crossings.popleft()
            self._received_bytes += received_bytes
            self._received_packets += received_packets
        if crossings and crossings[0][0] < served:
            start, end, received_bytes, _ = crossings[0]
            return self._received_bytes + received_bytes * (served - start) / (end - start), self._received_packets
        return self._received_bytes, self._received_packets
