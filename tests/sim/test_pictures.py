"""Samples larger than the queue of the link, in virtual time."""

import pytest

from arpd.daemon.scenario import Scenario
from arpd.model.endpoints import Direction
from arpd.model.settings import RelaySettings, Settings
from arpd.sim.ends import SimulatedLinkTopic
from arpd.sim.link import LinkModel
from arpd.sim.result import SimTopic
from arpd.sim.schedule import RateSchedule, outages

TOPICS = (
    SimTopic(name="/camera", payload_bytes=900_000, rate_hz=10.0),
    SimTopic(name="/imu", payload_bytes=324, rate_hz=100.0),
    SimTopic(name="/cmd_vel", payload_bytes=52, rate_hz=20.0, direction=Direction.ACTUATION),
)
ENDS = Settings(relay=RelaySettings(link_domain=77))
LASTS_S = 30.0


@pytest.mark.parametrize("pushes_back", [True, False], ids=["sender", "middle"])
def test_a_picture_larger_than_the_queue_arrives_and_an_imu_beside_it(pushes_back):
    """On either kind of bottleneck pictures arrive, as old as the link makes them, and no sample of the IMU is lost."""
    model = LinkModel(pushes_back=pushes_back)
    lasts_s = 60.0  # 120 pictures: the 99th percentile leaves out the last, which no later one helps over its losses
    result = Scenario(Settings(), RateSchedule.parse("0:20mbit"), lasts_s, model=model, topics=TOPICS).play()
    camera, imu, _ = result.topics
    assert camera.received / lasts_s > (1.5 if pushes_back else 0.8)
    assert camera.latency_p99_s < 1.0
    assert imu.lost == imu.withheld == 0
    assert imu.latency_p99_s < (0.08 if pushes_back else 0.15)


@pytest.mark.parametrize("pushes_back", [True, False], ids=["sender", "middle"])
@pytest.mark.parametrize("rates", ["0:5mbit", "0:20mbit,15:5mbit"])
def test_nothing_waits_behind_a_picture_that_crosses_two_ends(rates, pushes_back):
    """Pictures fill the link; an IMU and commands lose nothing, and wait 20 ms more than alone."""
    model = LinkModel(pushes_back=pushes_back)
    result = Scenario(ENDS, RateSchedule.parse(rates), LASTS_S, model=model, topics=TOPICS).play()
    camera, imu, command = result.topics
    carried = result.moments[-1].carried_bytes
    assert camera.delivered_bytes > 0.75 * carried
    assert (camera.doubled, camera.reordered) == (0, 0)
    assert imu.received + command.received > 0.99 * (imu.offered + command.offered)
    assert max(imu.latency_p99_s, command.latency_p99_s) < (0.05 if "," in rates else 0.0225)
    assert imu.latency_max_s < 0.25


def test_after_an_outage_of_two_ends_no_old_command_runs():
    """What waited while the link was out is replaced by what is newer, in both directions."""
    model = LinkModel(losses=outages((12.0, 16.0)))
    result = Scenario(ENDS, RateSchedule.parse("0:20mbit"), LASTS_S, model=model, topics=TOPICS).play()
    _, imu, command = result.topics
    for topic in (imu, command):
        assert topic.latency_max_s < 4.6
        late = 3.0 * topic.source_rate_hz
        assert topic.withheld > 0.8 * late
        assert topic.reordered == topic.doubled == 0


def test_two_ends_say_of_no_topic_that_its_writes_block(monkeypatch):
    """Nothing of theirs waits in publish(), also in an outage, so no alert may say that a node does."""
    told, state = [], SimulatedLinkTopic.state
    monkeypatch.setattr(SimulatedLinkTopic, "state", lambda topic: told.append(state(topic)) or told[-1])
    model = LinkModel(losses=outages((8.0, 12.0)))
    Scenario(ENDS, RateSchedule.parse("0:5mbit"), 15.0, model=model, topics=TOPICS).play()
    assert told
    assert {each.blocked_s for each in told} == {0.0}
