"""A link in virtual time: a FIFO bottleneck with tail drop, propagation delay and loss; and the way within a host."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.sim.aggregation import AggregatingBottleneck
from arpd.sim.bottleneck import FluidBottleneck
from arpd.sim.loss import Losses, check_ascending, check_probability, either, loss_at
from arpd.sim.service import Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from arpd.sim.bottleneck import Bottleneck
    from arpd.sim.loss import GilbertElliott, LossStep
    from arpd.sim.schedule import RateSchedule
    from arpd.sim.timeline import Timeline

_MTU_FRAME_BYTES = 1514
_ON_HOST_S = 0.001


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkModel:
    """Properties of a link besides its rate; the queue is the same as in `scripts.netns.simlink`.

    Parameters
    ----------
    delay_s : one-way propagation delay (s)
    queue_bytes : queue in front of the bottleneck, with tail drop (bytes)
    loss : probability that a packet is lost after it has used the link, 0..1
    outages : spans of run time in which nothing arrives in either direction (s, s)
    losses : further loss over run time, by ascending start
    bursts : further loss in bursts, at different times for each direction
    packet_overhead_s : link time that a transmission takes beyond its bytes, >= 0 (s)
    aggregate_packets : most packets of one transmission if they wait together, >= 1; all of them arrive when it ends,
        as in an A-MPDU of IEEE 802.11n
    pushes_back : whether the bottleneck is the sender's interface, where a full queue makes a writer wait; otherwise it
        is between the hosts, an access point for example
    firmware_bytes : bytes that the adapter holds below the interface's counter, hidden from the host, >= 0 (bytes)
    """

    delay_s: float = 0.002
    queue_bytes: int = 256_000
    pushes_back: bool = True
    loss: float = 0.0
    outages: tuple[tuple[float, float], ...] = ()
    losses: tuple[LossStep, ...] = ()
    bursts: GilbertElliott | None = None
    packet_overhead_s: float = 0.0
    aggregate_packets: int = 1
    firmware_bytes: int = 0

    def __post_init__(self) -> None:
        check_probability("loss", self.loss)
        check_ascending(self.losses)
        least = {"delay_s": 0, "queue_bytes": 0, "packet_overhead_s": 0, "aggregate_packets": 1, "firmware_bytes": 0}
        for name, bound in least.items():
            if not bound <= (value := getattr(self, name)) < math.inf:
                raise ValueError(f"{name} {value}: must be {bound} or more")

    def loss_ratio(self, run_s: float) -> float:
        """Return the share of packets that are lost; bursts count by their mean, outages not at all."""
        bursts = self.bursts.mean_loss if self.bursts else 0.0
        return either(either(self.loss, loss_at(self.losses, run_s)), bursts)


class SimulatedLink:
    """One direction of the link.

    Parameters
    ----------
    timeline : virtual time
    schedule : rate over run time
    origin_s : start of run time (s)
    model : other properties of the link
    random : source of the losses
    """

    def __init__(
        self, timeline: Timeline, schedule: RateSchedule, *, origin_s: float, model: LinkModel, random: Random
    ) -> None:
        self._timeline = timeline
        self._firmware_bytes = model.firmware_bytes
        self._service = Service(schedule, origin_s)
        losses = Losses(
            loss=model.loss,
            steps=model.losses,
            bursts=model.bursts,
            outages=model.outages,
            origin_s=origin_s,
            random=random,
        )
        # One frame is in service, not queued.
        room_bytes = model.queue_bytes + model.firmware_bytes + _MTU_FRAME_BYTES
        self._bottleneck: Bottleneck
        if model.packet_overhead_s == 0.0 and model.aggregate_packets == 1:
            self._bottleneck = FluidBottleneck(
                timeline, self._service, losses, delay_s=model.delay_s, room_bytes=room_bytes
            )
        else:
            self._bottleneck = AggregatingBottleneck(
                timeline,
                self._service,
                losses,
                delay_s=model.delay_s,
                room_bytes=room_bytes,
                overhead_s=model.packet_overhead_s,
                aggregate_packets=model.aggregate_packets,
            )

    def send(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:
        """Put one datagram on the link; ``deliver`` runs when its last fragment arrives, unless one is missing.

        Parameters
        ----------
        wire_bytes : bytes of all fragments, headers included (bytes)
        packets : fragments

        Returns
        -------
        Moment at which all of it has arrived or is lost; if others join its transmission, it is a little later (s).
        """
        return self._bottleneck.put(wire_bytes, packets, deliver)

    @property
    def capacity_bytes_per_second(self) -> float:
        """Rate at which the link carries bytes now, without the overhead of packets (bytes/s)."""
        return self._service.rate_at(self._timeline.now_s)

    @property
    def backlog_bytes(self) -> float:
        """Bytes in the host's queue, above the firmware."""
        return max(0.0, self._bottleneck.waiting_bytes() - self._firmware_bytes)

    @property
    def queue_delay_s(self) -> float:
        """Time that a packet sent now would wait in the host and in the firmware (s)."""
        return self._bottleneck.wait_s()

    @property
    def sent_bytes(self) -> float:
        """Bytes that have left the near interface."""
        return self._bottleneck.accepted_bytes - self.backlog_bytes

    @property
    def sent_packets(self) -> int:
        """Packets that the near interface accepted."""
        return self._bottleneck.accepted_packets

    @property
    def dropped_packets(self) -> int:
        """Packets dropped because the queue was full."""
        return self._bottleneck.dropped_packets

    @property
    def lost_packets(self) -> int:
        """Packets that were sent but will not arrive."""
        return self._bottleneck.lost_packets

    def received_bytes(self) -> float:
        """Return the bytes that have reached the far interface."""
        return self._bottleneck.received()[0]

    @property
    def received_packets(self) -> int:
        """Packets that have reached the far interface."""
        return self._bottleneck.received()[1]


class Loopback:
    """The way between two processes of one host; nothing waits, and nothing is lost."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline

    def send(self, wire_bytes: float, packets: int, deliver: Callable[[], object]) -> float:  # noqa: ARG002 - as a link
        """Deliver a datagram after a millisecond; return when (s)."""
        arrival_s = self._timeline.now_s + _ON_HOST_S
        self._timeline.at(arrival_s, deliver)
        return arrival_s
