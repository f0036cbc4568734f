"""A link in virtual time: a FIFO bottleneck with tail drop, propagation delay and loss; a host; other traffic."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.sim.schedule import LossStep, RateSchedule, Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from arpd.sim.timeline import Timeline

FRAME_BYTES = 1514  # on the wire, of a full packet
_ON_HOST_S = 0.001
# Arrivals are counted when they are asked for, which may take an hour, or when there may be so many.
_MOST_UNCOUNTED = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkModel:
    """Properties of a link besides its rate; the queue is the same as in `scripts.netns.simlink`.

    Parameters
    ----------
    delay_s : one-way propagation delay (s)
    queue_bytes : queue in front of the bottleneck, with tail drop (bytes)
    loss : probability that a packet is lost after it has used the link, 0..1
    losses : further loss over run time in both directions, by ascending start; 1 = nothing arrives
    packet_overhead_s : link time that a transmission takes beyond its bytes, >= 0 (s)
    aggregate_packets : most packets of one transmission, where so many wait, >= 1
    pushes_back : whether the bottleneck is the sender's interface, where a full queue makes a writer wait; otherwise it
        is between the hosts, an access point for example
    firmware_bytes : bytes that the adapter holds below the interface's counter, hidden from the host, >= 0 (bytes)
    """

    delay_s: float = 0.002
    queue_bytes: int = 256_000
    pushes_back: bool = True
    loss: float = 0.0
    losses: tuple[LossStep, ...] = ()
    packet_overhead_s: float = 0.0
    aggregate_packets: int = 1
    firmware_bytes: int = 0

    def loss_ratio(self, run_s: float) -> float:
        """Return the share of packets that are lost at this time."""
        begun = bisect_right(self.losses, run_s, key=lambda step: step.start_s)
        further = self.losses[begun - 1].loss if begun else 0.0
        return 1.0 - (1.0 - self.loss) * (1.0 - further)


class SimulatedLink:
    """One direction of the link.

    It needs no event per packet: it is never idle while it holds something, so a datagram leaves when the backlog
    before it and the datagram itself have been served, and that moment is known at once. Packets that wait share
    transmissions, and each takes its part of their overhead; an idle link does not wait for more packets.

    Parameters
    ----------
    timeline : virtual time
    schedule : rate over the time of the timeline
    model : other properties of the link
    random : source of the losses

    Attributes
    ----------
    sent_packets : accepted by the near interface
    dropped_packets : dropped because the queue was full
    lost_packets : sent, but they will not arrive
    """

    def __init__(self, timeline: Timeline, schedule: RateSchedule, *, model: LinkModel, random: Random) -> None:
        self._timeline, self._model, self._random = timeline, model, random
        self._service = Service(schedule)
        # One frame is in service, not queued.
        self._room_bytes = model.queue_bytes + model.firmware_bytes + FRAME_BYTES
        self._is_lossless = not (model.loss or model.losses)
        self._accepted_bytes = 0.0
        self._busy_until = self._service.by(timeline.now_s)  # bytes that the service can have carried by then
        self._left, self._come = _Passed(), _Passed()
        self.sent_packets = self.dropped_packets = self.lost_packets = 0

    def send(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Put one datagram on the link; ``deliver`` runs when its last fragment arrives, unless one is missing.

        Parameters
        ----------
        wire_bytes : bytes of all fragments, headers included (bytes)
        packets : fragments

        Returns
        -------
        Moment at which all of it has arrived or is lost (s).
        """
        now_s, packet_bytes = self._timeline.now_s, wire_bytes / packets
        room = self._room_bytes - self._waiting_bytes()
        accepted = packets if wire_bytes <= room else max(0, int(room // packet_bytes))
        self.dropped_packets += packets - accepted
        if not accepted:
            return now_s
        size = accepted * packet_bytes
        begins = self._begins(accepted)
        self._accepted_bytes += size
        self.sent_packets += accepted
        self._busy_until = ends = begins + size
        arrival_s = self._service.when(ends) + self._model.delay_s
        surviving = accepted if self._is_lossless else self._survivors(accepted, arrival_s)
        self._left.add(begins, ends, size, accepted)
        self._come.add(begins, ends, surviving * packet_bytes, surviving)
        if len(self._come) > _MOST_UNCOUNTED:
            self._received()
        self.lost_packets += accepted - surviving
        if surviving == packets:
            self._timeline.at(arrival_s, deliver)
        return arrival_s

    @property
    def backlog_bytes(self) -> float:
        """Bytes in the host's queue, above the firmware."""
        return max(0.0, self._waiting_bytes() - self._model.firmware_bytes)

    @property
    def queue_delay_s(self) -> float:
        """Time that a packet sent now would wait in the host and in the firmware (s)."""
        return self._service.when(self._busy_until) - self._timeline.now_s if self._waiting_bytes() > 0.0 else 0.0

    @property
    def sent_bytes(self) -> float:
        """Bytes that have left the near interface."""
        return self._accepted_bytes - self.backlog_bytes

    def received_bytes(self) -> float:
        """Return the bytes that have reached the far interface, part of a datagram included."""
        return self._received()[0]

    @property
    def received_packets(self) -> int:
        """Packets that have reached the far interface."""
        return self._received()[1]

    def _begins(self, packets: int) -> float:
        """Return what the service can have carried when the first byte of so many packets is sent (bytes)."""
        served = self._service.by(self._timeline.now_s)
        starts = max(served, self._busy_until)
        if not self._model.packet_overhead_s:
            return starts
        transmissions = packets / self._model.aggregate_packets
        if starts == served:
            transmissions = math.ceil(transmissions)
        start_s = max(self._timeline.now_s, self._service.when(starts))
        if math.isinf(start_s):
            return starts
        return max(starts, self._service.by(start_s + transmissions * self._model.packet_overhead_s))

    def _waiting_bytes(self) -> float:
        """Return the bytes in the queue and in service; the overhead of their transmissions is none."""
        return max(0.0, self._accepted_bytes - self._left.by(self._service.by(self._timeline.now_s))[0])

    def _received(self) -> tuple[float, int]:
        return self._come.by(self._service.by(self._timeline.now_s - self._model.delay_s))

    def _survivors(self, packets: int, at_s: float) -> int:
        """Return how many of the packets that are due at this moment arrive; what is never due is not lost."""
        if math.isinf(at_s):
            return packets
        loss = self._model.loss_ratio(at_s)
        return sum([self._random.random() >= loss for _ in range(packets)]) if loss else packets


class _Passed:
    """Counts what has passed a point of the link."""

    def __init__(self) -> None:
        # Of each datagram: what the service has carried when its first and its last byte leave, its bytes and packets.
        self._under_way: deque[tuple[float, float, float, int]] = deque()
        self._bytes, self._packets = 0.0, 0

    def __len__(self) -> int:
        return len(self._under_way)

    def add(self, begins: float, ends: float, size: float, packets: int) -> None:
        self._under_way.append((begins, ends, size, packets))

    def by(self, served: float) -> tuple[float, int]:
        """Return what has passed when the service has carried so many bytes; never less than before."""
        under_way = self._under_way
        while under_way and under_way[0][1] <= served:
            _, _, size, packets = under_way.popleft()
            self._bytes += size
            self._packets += packets
        if under_way and under_way[0][0] < served:
            begins, ends, size, _ = under_way[0]
            return self._bytes + size * (served - begins) / (ends - begins), self._packets
        return self._bytes, self._packets


class Loopback:
    """The way between two processes of one host; nothing waits, and nothing is lost."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline

    def send(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:  # noqa: ARG002 - as a link
        """Deliver a datagram after a millisecond; return when (s)."""
        arrival_s = self._timeline.now_s + _ON_HOST_S
        self._timeline.at(arrival_s, deliver)
        return arrival_s


@dataclass(frozen=True, kw_only=True, slots=True)
class CrossFlow:
    """A flow of full packets at a fixed rate: an upload from the robot, or a download of the peer.

    Parameters
    ----------
    start_s, end_s : run time of the first packet, and of the end (s)
    rate_bytes_per_second : wire bytes offered to the link (bytes/s)
    """

    start_s: float
    end_s: float
    rate_bytes_per_second: float

    def offered_bytes(self, t_s: float) -> float:
        """Return the bytes offered by a moment."""
        return self.rate_bytes_per_second * (min(max(t_s, self.start_s), self.end_s) - self.start_s)

    def play(self, timeline: Timeline, link: SimulatedLink, packets: int = 0) -> None:
        """Plan the next packet, after so many; it plans the one after."""
        at_s = self.start_s + packets * FRAME_BYTES / self.rate_bytes_per_second

        def send() -> None:
            link.send(FRAME_BYTES, 1, lambda: None)
            self.play(timeline, link, packets + 1)

        if at_s < self.end_s:
            timeline.at(at_s, send)
