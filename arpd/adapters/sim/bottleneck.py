"""The bottleneck of a simulated link: a queue with tail drop, and the pipe behind it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.adapters.sim.loss import Losses
    from arpd.adapters.sim.service import Service
    from arpd.adapters.sim.timeline import Timeline


#: What has arrived is counted when somebody asks, or when so much may have; nobody may ask in an hour.
MOST_UNCOUNTED = 1000


class Bottleneck(ABC):
    """What queues, serves and delivers datagrams; it counts what it took, whatever became of it later.

    Parameters
    ----------
    timeline : virtual time
    service : the rate
    losses : decides what arrives
    delay_s : propagation (s)
    room_bytes : what fits in, what is being served included (bytes)

    Attributes
    ----------
    accepted_bytes, accepted_packets : taken into the queue
    dropped_packets : refused, because the queue was full
    lost_packets : sent, and lost on the way
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
        """Queue a datagram; return when nothing of it is on the way any more, as far as it is known (s)."""

    @abstractmethod
    def waiting_bytes(self) -> float:
        """Return what is queued or being served (bytes)."""

    @abstractmethod
    def wait_s(self) -> float:
        """Return how long a packet put now would wait before it is served (s)."""

    @abstractmethod
    def received(self) -> tuple[float, int]:
        """Return what has reached the far interface (bytes, packets)."""

    def _admit(self, wire_bytes: float, packets: int, room_bytes: float) -> int:
        """Take as many packets of a datagram as there is room for, and count them."""
        packet_bytes = wire_bytes / packets
        accepted = packets if wire_bytes <= room_bytes else max(0, int(room_bytes // packet_bytes))
        self.dropped_packets += packets - accepted
        self.accepted_bytes += accepted * packet_bytes
        self.accepted_packets += accepted
        return accepted


class FluidBottleneck(Bottleneck):
    """A bottleneck that serves bytes, one after the other, and nothing else.

    A FIFO that is never idle while it holds something needs no event per packet: a datagram that arrives behind a
    backlog leaves when the bottleneck has served the backlog and the datagram, and that moment is known at once.
    """

    def __init__(
        self, timeline: Timeline, service: Service, losses: Losses, *, delay_s: float, room_bytes: int
    ) -> None:
        super().__init__(timeline, service, losses, delay_s=delay_s, room_bytes=room_bytes)
        self._busy_until = service.by(timeline.now_s)
        self._crossings: deque[tuple[float, float, float, int]] = deque()  # service start and end, bytes, packets

    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when nothing of it is on the way any more (s)."""
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
        """Return what is queued or being served (bytes)."""
        return max(0.0, self._busy_until - self._service.by(self._timeline.now_s))

    def wait_s(self) -> float:
        """Return how long a packet put now would wait (s)."""
        return self._service.when(self._busy_until) - self._timeline.now_s if self.waiting_bytes() > 0 else 0.0

    def received(self) -> tuple[float, int]:
        """Return what has reached the far interface, the datagram being received included in part (bytes, packets)."""
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
