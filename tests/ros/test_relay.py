"""The relay with real rclpy: unmodified publishers in, AdaptivePublishers out."""

import time
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from arpd.adapters.ros.relay import Relay
from arpd.model.settings import Overflow, RelaySettings
from tests.ros.domain import DOMAIN
from tests.ros.ends_world import is_whole, numbers

pytestmark = pytest.mark.ros

BEST_EFFORT = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def lines():
    """Status lines of the relay, oldest first."""
    return []


def shown(lines):
    """Return a function that appends the line of a status."""
    return lambda status: lines.append(status.line)


def test_it_carries_what_an_unmodified_node_publishes(ros, lines, background, eventually):
    """Messages of a plain publisher on /chatter arrive unchanged on /link/chatter."""
    talker = Numbers(ros.node("plain").create_publisher(String, "/chatter", 1000), "plain")
    received = listen(ros.node("far"), "/link/chatter")
    settings = RelaySettings(topics=("/chatter", "/never"), depths={"/chatter": 1000})
    Relay(ros.node("relay"), settings, on_change=shown(lines))
    background(talker.talk)
    eventually("samples arrive", lambda: len(received) > 20)
    assert is_whole(received, "plain")
    eventually("the other one is named", lambda: lines[-1] == "relaying 1 of 2 topics; not published yet: /never")


def test_a_latched_topic_stays_latched(ros, lines, eventually):
    """A late reader of the relayed topic receives the map published before it joined."""
    talker = ros.node("map_server").create_publisher(String, "/map", LATCHED)
    talker.publish(String(data="the map"))
    Relay(ros.node("relay"), RelaySettings(topics=("/map",)), on_change=shown(lines))
    eventually("it is carried", lambda: lines[-1] == "relaying 1 of 1 topics")
    received = []
    ros.node("late").create_subscription(String, "/link/map", lambda m: received.append(m.data), LATCHED)
    eventually("the late reader gets the map", lambda: received == ["the map"])


@pytest.fixture
def elsewhere(ros):
    """Make a node in its own participant, as in its own process: within one participant a topic has one type."""
    with ExitStack() as stack:

        def node(name, executor=SingleThreadedExecutor, **options):
            context = rclpy.Context()
            rclpy.init(context=context, domain_id=DOMAIN)
            stack.callback(rclpy.try_shutdown, context=context)
            return type(ros)(context, stack).node(name, executor(context=context), **options)

        yield node


class Numbers:
    """A talker that publishes its name and consecutive numbers."""

    def __init__(self, publisher, name, rate_hz=20):
        self.publisher, self.name, self.rate_hz, self.sent = publisher, name, rate_hz, 0

    def talk(self, stopping):
        while not stopping.is_set():
            self.publisher.publish(String(data=f"{self.name} {self.sent}"))
            self.sent += 1
            time.sleep(1 / self.rate_hz)


def listen(node, topic):
    received = []
    node.create_subscription(String, topic, lambda m: received.append(m.data), 1000)
    return received


SETTINGS = RelaySettings(topics=("/chatter",), overflow={"/chatter": Overflow.QUEUE}, depths={"/chatter": 1000})


@pytest.mark.parametrize("executor", [SingleThreadedExecutor, EventsExecutor])
def test_a_best_effort_publisher_that_joins_later_is_heard(elsewhere, lines, background, eventually, executor):
    """A best-effort publisher that joins is carried too, and the first one's messages are not lost or doubled."""
    reliable = Numbers(elsewhere("first").create_publisher(String, "/chatter", 1000), "first")
    received = listen(elsewhere("far"), "/link/chatter")
    Relay(elsewhere("relay", executor), SETTINGS, on_change=shown(lines))
    background(reliable.talk)
    eventually("the first one is heard", lambda: len(numbers(received, "first")) > 20)
    weak = Numbers(elsewhere("second").create_publisher(String, "/chatter", BEST_EFFORT), "second")
    background(weak.talk)
    eventually("the second one is heard", lambda: len(numbers(received, "second")) > 20)
    so_far = reliable.sent
    eventually("the first one goes on", lambda: numbers(received, "first")[-1] >= so_far)
    assert is_whole(received, "first")
