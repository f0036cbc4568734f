"""The simulated reliable writer and its reader keep Fast DDS's promises over links that lose, drop and stop."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.sim.arrivals import Arrivals
from arpd.adapters.sim.link import LinkModel, SimulatedLink
from arpd.adapters.sim.schedule import RateSchedule
from arpd.adapters.sim.timeline import Timeline
from arpd.adapters.sim.writer import SAMPLE, LinkPath, SimulatedWriter
from arpd.model.endpoints import WriterQos
from arpd.model.wire import HEARTBEAT_BYTES, wire_size

ORIGIN_S = 1000.0


class Delivered(Arrivals):
    """Records the samples that a reader receives, with order and time."""

    def __init__(self, timeline):
        super().__init__()
        self._timeline = timeline
        self.arrived = []
        self.delivered = []
        self.at_s = {}

    def on_arrival(self, sequence, latency_s):
        self.arrived.append(sequence)

    def on_delivery(self, sequence, stamp_s, size_bytes):
        self.delivered.append(sequence)
        self.at_s[sequence] = self._timeline.now_s - ORIGIN_S


class World:
    """One writer, one reader, and the link between them."""

    def __init__(self, *, depth, heartbeat_s=0.05, rate="0:20mbit", payload_bytes=500, seed=1, **model):
        self.timeline = Timeline(ORIGIN_S)
        self.there, self.back = (
            SimulatedLink(
                self.timeline,
                RateSchedule.parse(rate),
                origin_s=ORIGIN_S,
                model=LinkModel(**model),
                random=Random(f"{seed} {name}"),
            )
            for name in ("there", "back")
        )
        self.reader = Delivered(self.timeline)
        self.published = 0
        self.writer = SimulatedWriter(
            LinkPath(timeline=self.timeline, there=self.there, back=self.back),
            self.reader,
            payload_bytes=payload_bytes,
            qos=WriterQos(depth=depth, deadline_ns=0),
            heartbeat_s=heartbeat_s,
        )

    def publish(self, samples, *, every_s=0.0):
        for _ in range(samples):
            self.writer.publish(SAMPLE.pack(self.published, self.timeline.now_s))
            self.published += 1
            self.wait(every_s)

    def wait(self, duration_s):
        self.timeline.run_until(self.timeline.now_s + duration_s)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 40), st.integers(1, 40), st.sampled_from([0.0, 0.1, 0.4]), st.sampled_from([0.0, 0.03]), st.data()
)
def test_whatever_the_history_holds_is_delivered_once_and_in_order(samples, depth, loss, every_s, data):
    """Under loss in both directions no sample comes twice or out of order, and all of the last ``depth`` arrive."""
    world = World(depth=depth, loss=loss, seed=data.draw(st.integers(0, 99)))
    world.publish(samples, every_s=every_s)
    world.wait(60.0)
    assert world.reader.delivered == sorted(set(world.reader.delivered))
    assert set(range(max(0, samples - depth), samples)) <= set(world.reader.delivered)
    assert world.writer.is_acknowledged()


@pytest.mark.parametrize("loss", [0.05, 0.3])
def test_a_history_that_is_deep_enough_loses_nothing(loss):
    """Every sample arrives if the history holds all of them."""
    world = World(depth=200, loss=loss)
    world.publish(200, every_s=0.01)
    world.wait(60.0)
    assert world.reader.delivered == list(range(200))


def test_a_full_history_drops_the_oldest_though_nobody_has_it():
    """Samples that leave the history during an outage never arrive; the last ``depth`` do."""
    world = World(depth=3, outages=((0.0, 2.0),))
    world.publish(10, every_s=0.1)
    world.wait(10.0)
    assert world.reader.delivered == [7, 8, 9]
    assert world.writer.is_acknowledged()


def test_a_full_history_drops_the_oldest_that_everybody_has():
    """An acknowledged sample stays until newer ones replace it, because KEEP_LAST counts it."""
    world = World(depth=3)
    world.publish(10, every_s=0.1)
    world.wait(1.0)
    assert world.writer.is_acknowledged()
    assert [SAMPLE.unpack(sample)[0] for sample in world.writer._history.values()] == [7, 8, 9]


@pytest.mark.parametrize("depth", [1, 100])
def test_heartbeats_stop_when_all_is_acknowledged(depth):
    """A writer whose reader has every sample is silent until the next sample."""
    world = World(depth=depth, loss=0.2)
    for _ in range(3):
        world.publish(20)
        world.wait(30.0)
        assert world.writer.is_acknowledged()
        said = world.there.sent_packets, world.back.sent_packets
        world.wait(30.0)
        assert (world.there.sent_packets, world.back.sent_packets) == said
    assert said[0] > 60


def test_heartbeats_go_on_until_an_acknowledgement_comes():
    """Without an acknowledgement there is one heartbeat in every period."""
    world = World(depth=100, heartbeat_s=0.5, outages=((0.0, 10.25),))
    world.publish(1)
    world.wait(10.2)
    assert world.there.sent_packets == 1 + 20
    world.wait(1.0)
    assert world.writer.is_acknowledged()


def test_what_is_in_order_does_not_wait_for_a_heartbeat():
    """The reader delivers a sample in order when it arrives, before the next heartbeat."""
    world = World(depth=100, heartbeat_s=3.0)
    world.publish(5, every_s=0.1)
    world.wait(0.1)
    assert world.reader.delivered == [0, 1, 2, 3, 4]
    assert world.reader.at_s[4] == pytest.approx(0.4, abs=0.01)


def test_what_comes_behind_a_gap_waits_for_it():
    """The reader delivers the samples after a lost one only after that one."""
    world = World(depth=100, heartbeat_s=0.5, outages=((0.05, 0.15),))
    world.publish(5, every_s=0.1)
    world.wait(5.0)
    assert world.reader.arrived == [0, 2, 3, 4, 1]
    assert world.reader.delivered == [0, 1, 2, 3, 4]
    assert 0.5 < world.reader.at_s[1] == world.reader.at_s[4] < 0.52


def test_a_writer_that_is_destroyed_repeats_nothing():
    """After the destruction, samples on the link arrive, lost ones stay lost, and no heartbeat goes out."""
    world = World(depth=100, outages=((0.0, 0.2),), delay_s=0.05)
    world.publish(5)
    world.wait(0.19)
    world.publish(1)
    world.writer.destroy()
    said = world.there.sent_packets
    world.wait(10.0)
    assert world.reader.arrived == [5]
    assert world.there.sent_packets == said


def test_nothing_is_sent_again_while_it_is_on_its_way():
    """On a slow link each sample crosses once, although the reader asks for it repeatedly."""
    world = World(depth=20, heartbeat_s=0.05, rate="0:100kbit", payload_bytes=1000)
    world.publish(20)
    world.wait(30.0)
    assert world.reader.delivered == list(range(20))
    wire_bytes, _ = wire_size(1000, rate_hz=math.inf)
    heartbeats = world.there.sent_packets - 20
    assert heartbeats > 20
    assert world.there.sent_bytes == pytest.approx(20 * wire_bytes + heartbeats * HEARTBEAT_BYTES)


def test_an_acknowledgement_names_256_numbers_at_most():
    """After a long outage the reader asks in portions, and finally has all of a deep history."""
    world = World(depth=1000, heartbeat_s=1.0, payload_bytes=100, outages=((0.0, 2.5),))
    world.publish(900)
    world.wait(3.1)
    assert 0 < len(world.reader.delivered) <= 256
    world.wait(10.0)
    assert world.reader.delivered == list(range(900))
