"""The bottleneck of a simulated link: a queue with tail drop, and the pipe behind it."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.sim.loss import Losses
    from arpd.sim.service import Service
    from arpd.sim.timeline import Timeline


#: What has arrived is counted when somebody asks, or when so much may have; nobody may ask in an hour.
MOST_UNCOUNTED = 1000


class Bottleneck(Protocol):
    """What queues, serves and delivers datagrams; it counts what it took, whatever became of it later.

    Attributes
    ----------
    accepted_bytes, accepted_packets : taken into the queue
    dropped_packets : refused, because the queue was full
    lost_packets : sent, and lost on the way
    """

    accepted_bytes: float
    accepted_packets: int
    dropped_packets: int
    lost_packets: int

    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when nothing of it is on the way any more, as far as it is known (s)."""
        ...

    def waiting_bytes(self) -> float:
        """Return what is queued or being served (bytes)."""
        ...

    def wait_s(self) -> float:
        """Return how long a packet put now would wait before it is served (s)."""
        ...

    def received(self) -> tuple[float, int]:
        """Return what has reached the far interface (bytes, packets)."""
        ...


class FluidBottleneck:
    """A bottleneck that serves bytes, one after the other, and nothing else.

    A FIFO that is never idle while it holds something needs no event per packet: a datagram that arrives behind a
    backlog leaves when the bottleneck has served the backlog and the datagram, and that moment is known at once.

    Parameters
    ----------
    timeline : virtual time
    service : the rate
    losses : decides what arrives
    delay_s : propagation (s)
    room_bytes : what fits in, what is being served included (bytes)
    """

    def __init__(
        self, timeline: Timeline, service: Service, losses: Losses, *, delay_s: float, room_bytes: int
    ) -> None:
        self._timeline = timeline
        self._service = service
        self._losses = losses
        self._delay_s = delay_s
        self._room_bytes = room_bytes
        self._busy_until = service.by(timeline.now_s)
        self._crossings: deque[tuple[float, float, float, int]] = deque()  # service start and end, bytes, packets
        self._received_bytes = 0.0
        self._received_packets = 0
        self.accepted_bytes = 0.0
        self.accepted_packets = 0
        self.dropped_packets = 0
        self.lost_packets = 0

    def put(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Queue a datagram; return when nothing of it is on the way any more (s)."""
        now_s = self._timeline.now_s
        start = self._service.by(now_s)
        room: float = self._room_bytes
        if self._busy_until > start:
            room -= self._busy_until - start
            start = self._busy_until
        fragment = wire_bytes / packets
        accepted = packets if wire_bytes <= room else max(0, int(room // fragment))
        if accepted < packets:
            self.dropped_packets += packets - accepted
            if not accepted:
                return now_s
        size = accepted * fragment
        self._busy_until = end = start + size
        self.accepted_bytes += size
        self.accepted_packets += accepted
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
