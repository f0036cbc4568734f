"""A simulated socket pushes back where the bottleneck is the sender's, and nowhere else."""

from __future__ import annotations

import math
from random import Random

import pytest

from arpd.model.endpoints import WriterQos
from arpd.sim.link import LinkModel, SimulatedLink
from arpd.sim.result import Arrivals
from arpd.sim.schedule import RateSchedule
from arpd.sim.socket import SOCKET_BYTES, Socket
from arpd.sim.timeline import Timeline
from arpd.sim.writer import SAMPLE, Counting, SimulatedWriter

PICTURE = 900_000


class Sender:
    """A camera's writer over a link of 20 Mbit/s."""

    def __init__(self, room_bytes, loss=0.0):
        self.timeline, self.freed_s = Timeline(0.0), []
        self.there, self.back = (
            SimulatedLink(
                self.timeline,
                RateSchedule.parse("0:20mbit"),
                model=LinkModel(loss=loss),
                random=Random(name),
            )
            for name in ("there", "back")
        )
        self.socket = Socket(
            self.timeline,
            self.there,
            room_bytes=room_bytes,
            on_free=lambda: self.freed_s.append(self.timeline.now_s),
        )
        self.arrivals = Arrivals()
        self.writer = SimulatedWriter(
            self.socket,
            self.back,
            Counting(self.arrivals, self.timeline, PICTURE),
            qos=WriterQos(depth=1, deadline_ns=0),
            heartbeat_s=0.05,
        )
        self.writer.publish(SAMPLE.pack(0, 0.0).ljust(PICTURE))

    def longest_wait_s(self, for_s):
        """Return how long a small packet would have waited at most."""
        waits = []
        self.timeline.every(0.01, lambda: waits.append(self.there.queue_delay_s), first_s=0.01)
        self.timeline.run_until(for_s)
        return max(waits)


def test_a_write_larger_than_the_queue_blocks_until_it_has_left():
    """A picture behind a queue of 256 kB arrives whole, once; others wait behind one socket's buffer at most."""
    sender = Sender(SOCKET_BYTES)
    assert sender.socket.is_full
    assert sender.longest_wait_s(1.0) < 1.1 * SOCKET_BYTES / 2.5e6
    assert sender.freed_s == [pytest.approx((1.1 * PICTURE - SOCKET_BYTES) / 2.5e6, rel=0.15)]
    assert (len(sender.arrivals.sequences), sender.arrivals.doubled) == (1, 0)


def test_of_a_large_sample_only_what_was_lost_is_sent_again():
    """At 2 % loss a picture arrives, and takes little more of the link than without."""
    sender = Sender(SOCKET_BYTES, loss=0.02)
    sender.timeline.run_until(3.0)
    assert len(sender.arrivals.sequences) == 1
    assert sender.there.sent_bytes < 1.6 * PICTURE


def test_where_the_bottleneck_is_further_on_nobody_waits_and_the_queue_drops():
    """Between the hosts a picture larger than the queue blocks nobody and loses its end, which is sent again."""
    sender = Sender(math.inf)
    assert not sender.socket.is_full
    assert sender.there.dropped_packets > 0
    sender.timeline.run_until(1.0)
    assert len(sender.arrivals.sequences) == 1
