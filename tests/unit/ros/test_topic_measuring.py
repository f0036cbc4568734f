"""`arpd topics` on a graph and with samples that a test makes, in virtual time."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")


from arpd.ros import topic_measuring
from arpd.ros.graph import Endpoint
from arpd.ros.graph_view import ON_EVERY_NODE
from arpd.ros.link_topics import cannot_tell_hosts
from arpd.ros.raw_reader import Sample
from arpd.ros.rmw import Rmw
from arpd.ros.topic_measuring import TopicSurvey

OWN, ROBOT, RELAY = (bytes([place, *[1] * 11]) for place in range(3))  # on one host
BEYOND = bytes([3] * 12)


def endpoint(node, *, at=ROBOT):
    return Endpoint(gid=at + bytes(4), node=node)


class Topic:
    """A topic whose first writer publishes at a rate."""

    def __init__(self, *writers, readers=(), rate_hz=math.nan):
        self.writers, self.readers, self.rate_hz = writers, readers, rate_hz


class Reader:
    """What stands for a RawReader; it has arrived samples from the writers that it suits."""

    def __init__(self, world, topic, deliver):
        self._world, self.name, self.deliver = world, topic, deliver
        self.topic = world.topics[topic]
        self.is_reliable, self.is_latched = True, False
        self.number = 0
        self.due_s = world.now_s if self.topic.rate_hz > 0 else math.inf

    def take(self):
        self.number += 1
        self.due_s += 1 / self.topic.rate_hz
        self.deliver(Sample(bytes(100), b"writer", self.number))

    def destroy(self):
        self._world.open.remove(self)


class World:
    """A graph, readers and a clock that passes only while the survey sleeps."""

    own, rest_s = Endpoint(gid=OWN + bytes(4)), 0.0

    def __init__(self, monkeypatch):
        self.now_s = 0.0
        self.topics: dict[str, Topic] = {}
        self.open: list[Reader] = []
        self.read: list[str] = []
        self.relays: frozenset[bytes] = frozenset()
        for name, fake in {
            "GraphView": SimpleNamespace(of=lambda _node: self),
            "current_rmw": lambda: Rmw(name="rmw_fastrtps_cpp"),
            "RawReader": self.reader,
            "ReadingThread": lambda: SimpleNamespace(stop=lambda: None),
        }.items():
            monkeypatch.setattr(topic_measuring, name, fake)
        monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)

    def look(self):
        return len(self.types)

    @property
    def types(self):
        return dict.fromkeys(self.topics, ("std_msgs/msg/String",))

    def writers(self, topic):
        if topic == ON_EVERY_NODE:
            return [Endpoint(gid=each + bytes(4), node="/arpd_relay") for each in self.relays]
        return self.topics[topic].writers

    def readers(self, topic):
        return self.topics[topic].readers

    def reader(self, _node, _message, topic, _qos, *, deliver, thread):
        self.open.append(Reader(self, topic, deliver))
        self.read.append(topic)
        return self.open[-1]

    def sleep(self, seconds):
        until_s = self.now_s + seconds
        while (due := min(self.open, key=lambda each: each.due_s, default=None)) and due.due_s <= until_s:
            self.now_s = due.due_s
            due.take()
        self.now_s = until_s

    def list(self, seconds=5.0, **options):
        node = SimpleNamespace(context=SimpleNamespace(get_domain_id=lambda: 1))
        survey = TopicSurvey(
            node,
            is_of_interest=lambda _topic: True,
            clock=lambda: self.now_s,
            sleep=self.sleep,
            **{"prefix": "", **options},
        )
        return survey.run(seconds)

    def survey(self, **options):
        return {topic.name: topic for topic in self.list(**options).topics}


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


def test_a_topic_of_the_other_side_is_not_brought_over_the_link(world):
    """A topic that another host publishes, alone or with this one, gets no reader."""
    here, beyond = endpoint("/here"), endpoint("/beyond", at=BEYOND)
    world.topics = {
        "/commands": Topic(beyond, rate_hz=20),
        "/both": Topic(beyond, here, rate_hz=20),
        "/scan": Topic(here, readers=(beyond,), rate_hz=20),
    }
    found = world.survey()
    assert world.read == ["/scan"]
    assert (found["/commands"].far_writers, found["/commands"].traffic) == (("/beyond",), None)
    assert "beyond this host" in found["/commands"].unmeasured
    assert (found["/both"].writers, found["/both"].far_writers) == (("/here",), ("/beyond",))
    assert (found["/scan"].far_readers, found["/scan"].is_crossing) == (("/beyond",), True)


def test_a_ghost_is_measured_only_where_its_topic_crosses_anyway(world):
    """What arpd's relay writes for a node of the other side crosses once somebody here reads it, and not before."""
    ghost = endpoint("/planner", at=RELAY)
    world.relays = frozenset({RELAY})
    world.topics = {
        "/unread": Topic(ghost, rate_hz=20),
        "/cmd_vel": Topic(ghost, readers=(endpoint("/base"),), rate_hz=20),
    }
    found = world.survey()
    assert world.read == ["/cmd_vel"]
    assert (found["/unread"].far_writers, found["/unread"].traffic) == (("/planner",), None)
    assert (found["/cmd_vel"].far_writers, found["/cmd_vel"].is_crossing) == (("/planner",), True)
    assert found["/cmd_vel"].traffic.rate_hz == pytest.approx(20, rel=0.05)


def test_a_relayed_topic_is_listed_once(world):
    """A topic and what a relay with one end makes of it are one line, which crosses if somebody beyond reads it."""
    lidar, relay = endpoint("/lidar"), endpoint("/arpd_relay", at=RELAY)
    world.relays = frozenset({RELAY})
    world.topics = {
        "/scan": Topic(lidar, readers=(relay,), rate_hz=10),
        "/link/scan": Topic(relay),
        "/link/mine": Topic(lidar),
    }
    for readers in ((), (endpoint("/planner", at=BEYOND),)):
        world.topics["/link/scan"].readers = readers
        found = world.survey(prefix="/link")
        assert found.keys() == {"/scan", "/link/mine"}
        assert (found["/scan"].relayed_as, found["/scan"].is_crossing) == ("/link/scan", bool(readers))


def test_without_hosts_nothing_is_measured_and_the_reason_is_told(world, monkeypatch):
    """Where no GUID names its host, any topic may come over the link; the list says what helps."""
    monkeypatch.setattr(topic_measuring, "current_rmw", lambda: Rmw(name="rmw_other"))
    world.topics = {"/fast": Topic(endpoint("/talker"), rate_hz=50)}
    listed = world.list()
    assert not world.read
    assert [(topic.traffic, topic.unmeasured) for topic in listed.topics] == [(None, "its host is unknown")]
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in listed.cannot_tell_hosts
    assert not cannot_tell_hosts(Rmw(name="rmw_other"), {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
