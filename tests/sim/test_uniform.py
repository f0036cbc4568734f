"""The uniform policy with a robot on a link that falls, in virtual time."""

from __future__ import annotations

import pytest

from arpd.daemon.scenario import run
from arpd.model.endpoints import Direction
from arpd.model.settings import Policy, ProgramSettings, Settings
from arpd.sim.link import LinkModel
from arpd.sim.robot import SimTopic
from arpd.sim.schedule import RateSchedule

PACED = {"/camera": 30_000, "/scan": 6000, "/odom": 700}  # bytes
SOURCE_HZ, SLOW_HZ = 20.0, 1.5
TOPICS = (
    *(SimTopic(name=name, payload_bytes=size, rate_hz=SOURCE_HZ) for name, size in PACED.items()),
    SimTopic(name="/battery", payload_bytes=100, rate_hz=SLOW_HZ),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=SOURCE_HZ, direction=Direction.ACTUATION),
)
LASTS_S, FALLS_S = 30.0, 6.0


def test_all_topics_are_paced_alike():
    """Large and small topics, both ways, leave at one rate without a loss; a slower source keeps its own.

    A large topic has less until its first plan.
    """
    settings = Settings(program=ProgramSettings(policy=Policy.UNIFORM))
    schedule = RateSchedule.parse(f"0:10mbit,{FALLS_S}:2mbit")
    result = run(settings, schedule, LASTS_S, seed=1, managed=True, model=LinkModel(), topics=TOPICS)
    sent_hz = {topic.topic: topic.sent / LASTS_S for topic in result.topics}
    rates = [sent_hz[name] for name in (*PACED, "/cmd_vel")]
    assert max(rates) < 1.3 * min(rates)
    assert max(rates[1:]) < 1.1 * min(rates[1:])
    assert max(rates) < 0.7 * SOURCE_HZ
    assert sent_hz["/battery"] == pytest.approx(SLOW_HZ, rel=0.1)
    assert sum(topic.lost for topic in result.topics) == 0
