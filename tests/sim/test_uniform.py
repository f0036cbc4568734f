"""The uniform policy with a robot on a link that falls, in virtual time: pacing, plans and swaps as they are."""

from __future__ import annotations

from functools import cache

import pytest

from arpd.adapters.sim.link import LinkModel
from arpd.adapters.sim.robot import SimTopic
from arpd.adapters.sim.schedule import RateSchedule
from arpd.daemon.scenario import run
from arpd.model.endpoints import Direction
from arpd.model.settings import GraphSettings, Policy, ProgramSettings, Settings

PACED = {"/camera": 30_000, "/scan": 6000, "/odom": 700}  # bytes
SOURCE_HZ, SLOW_HZ = 20.0, 1.5
TOPICS = (
    *(SimTopic(name=name, payload_bytes=size, rate_hz=SOURCE_HZ) for name, size in PACED.items()),
    SimTopic(name="/battery", payload_bytes=100, rate_hz=SLOW_HZ),
    SimTopic(name="/cmd_vel", payload_bytes=80, rate_hz=SOURCE_HZ, direction=Direction.ACTUATION),
)
LASTS_S, FALLS_S = 30.0, 6.0


@cache
def played(policy=Policy.UNIFORM, count=None):
    settings = Settings(program=ProgramSettings(policy=policy), graph=GraphSettings(sensing_topics=count))
    schedule = RateSchedule.parse(f"0:10mbit,{FALLS_S}:2mbit")
    result = run(settings, schedule, LASTS_S, seed=1, managed=True, model=LinkModel(), topics=TOPICS)
    return {topic.topic: topic for topic in result.topics}, result


def sent_hz(topics, name):
    return topics[name].sent / LASTS_S


def test_all_topics_are_paced_alike():
    """Large and small topics, both ways, leave at one rate; a slower source keeps its own."""
    topics, _ = played()
    rates = [sent_hz(topics, name) for name in (*PACED, "/cmd_vel")]
    assert max(rates) < 1.1 * min(rates)
    assert max(rates) < 0.7 * SOURCE_HZ
    assert sent_hz(topics, "/battery") == pytest.approx(SLOW_HZ, rel=0.1)


def test_the_other_policy_paces_them_apart():
    """Per topic, the small ones keep the rate of their sources."""
    topics, _ = played(Policy.PER_TOPIC)
    assert sent_hz(topics, "/odom") > 2.0 * sent_hz(topics, "/camera")


def test_more_topics_on_the_link_make_all_slower():
    """A pinned N of more than twice the topics lowers every rate to less than half."""
    few, many = played()[0], played(count=11)[0]
    for name in PACED:
        assert sent_hz(many, name) < 0.6 * sent_hz(few, name)


def test_the_plan_follows_the_link():
    """Every publisher confirms the plans of start and fall, and no sample is lost."""
    topics, result = played()
    assert result.plans[0].cause == "start"
    assert any(moment.cause == "down" for moment in result.plans if moment.t_s > FALLS_S)
    assert result.moments[-1].planned == result.moments[-1].confirmed == len(TOPICS)
    assert sum(topic.lost for topic in topics.values()) == 0
