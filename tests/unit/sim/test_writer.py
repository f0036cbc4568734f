"""The simulated reliable writer and its reader keep Fast DDS's promises over links that lose, drop and stop."""

import math
from random import Random

from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import WriterQos
from arpd.sim.link import LinkModel, SimulatedLink
from arpd.sim.schedule import RateSchedule
from arpd.sim.socket import Socket
from arpd.sim.timeline import Timeline
from arpd.sim.writer import SimulatedWriter
from tests.examples import examples


@examples(60)
@given(
    st.integers(1, 40),
    st.integers(1, 40),
    st.sampled_from([0.0, 0.1, 0.4]),
    st.sampled_from([0.0, 0.03]),
    st.integers(0, 99),
)
def test_whatever_the_history_holds_is_delivered_once_and_in_order(samples, depth, loss, every_s, seed):
    """Under loss in both directions no sample comes twice or out of order, and all of the last ``depth`` arrive."""
    timeline, schedule = Timeline(0.0), RateSchedule.parse("0:20mbit")
    there, back = (
        SimulatedLink(timeline, schedule, model=LinkModel(loss=loss), random=Random(f"{seed} {name}"))
        for name in ("there", "back")
    )
    delivered, socket = [], Socket(timeline, there, room_bytes=math.inf)
    qos = WriterQos(depth=depth, deadline_ns=0)
    writer = SimulatedWriter(socket, back, lambda sample: delivered.append(int(sample)), qos=qos, heartbeat_s=0.05)
    for number in range(samples):
        writer.publish(str(number).encode().ljust(500))
        timeline.run_until(timeline.now_s + every_s)
    timeline.run_until(timeline.now_s + 60.0)
    assert delivered == sorted(set(delivered))
    assert set(range(max(0, samples - depth), samples)) <= set(delivered)
    assert writer.is_acknowledged()
