"""The simulated reliable writer and its reader keep Fast DDS's promises over links that lose, drop and stop."""

from __future__ import annotations

import math
from random import Random

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import WriterQos
from arpd.sim.link import LinkModel, SimulatedLink
from arpd.sim.result import SAMPLE, Arrivals, SimTopic
from arpd.sim.schedule import RateSchedule
from arpd.sim.socket import Socket
from arpd.sim.timeline import Timeline
from arpd.sim.writer import SimulatedWriter
from tests.examples import examples


class Delivered(Arrivals):
    """Records the samples that a reader receives, in order."""

    def __init__(self, timeline):
        super().__init__(timeline, SimTopic(name="/t", payload_bytes=500, rate_hz=1.0))
        self.delivered = []

    def on_delivery(self, sample):
        self.delivered.append(SAMPLE.unpack_from(sample)[0])


class World:
    """One writer, one reader, and the link between them."""

    def __init__(self, *, depth, seed=1, **model):
        self.timeline = Timeline(0.0)
        self.there, self.back = (
            SimulatedLink(
                self.timeline,
                RateSchedule.parse("0:20mbit"),
                model=LinkModel(**model),
                random=Random(f"{seed} {name}"),
            )
            for name in ("there", "back")
        )
        self.reader = Delivered(self.timeline)
        self.published = 0
        self.writer = SimulatedWriter(
            Socket(self.timeline, self.there, room_bytes=math.inf),
            self.back,
            self.reader,
            qos=WriterQos(depth=depth, deadline_ns=0),
            heartbeat_s=0.05,
        )

    def publish(self, samples, *, every_s=0.0):
        for _ in range(samples):
            self.writer.publish(SAMPLE.pack(self.published, self.timeline.now_s).ljust(500))
            self.published += 1
            self.wait(every_s)

    def wait(self, duration_s):
        self.timeline.run_until(self.timeline.now_s + duration_s)


@examples(60)
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
