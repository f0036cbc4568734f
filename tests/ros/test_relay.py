"""The relay with real rclpy: unmodified publishers in, AdaptivePublishers out."""

import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from arpd.ros.relay import Relay, UnknownTypeError, best_executor, message_class
from arpd.settings import RelaySettings

pytestmark = pytest.mark.ros


class DeafExecutor:
    """An executor that delivers nothing."""

    def __init__(self, context=None):
        self.add_node = self.remove_node = lambda _node: None
        self.shutdown = lambda: None

    def spin_once(self, timeout_sec):
        time.sleep(timeout_sec)


class Lines:
    def __init__(self):
        self.said = []

    def __call__(self, line):
        self.said.append(line)


@pytest.fixture
def lines():
    return Lines()


def test_it_carries_what_an_unmodified_node_publishes(ros, lines, background, eventually):
    """What a plain publisher sends on /chatter arrives unchanged on /link/chatter."""
    talker = ros.node("plain").create_publisher(String, "/chatter", 10)
    received = []
    ros.node("far").create_subscription(String, "/link/chatter", lambda m: received.append(m.data), 10)
    Relay(ros.node("relay"), RelaySettings(topics=("/chatter", "/never")), on_change=lines)

    def talk(stopping):
        number = 0
        while not stopping.is_set():
            talker.publish(String(data=str(number)))
            number += 1
            time.sleep(0.02)

    background(talk)
    eventually(lambda: len(received) > 20)
    assert received == [str(n) for n in range(int(received[0]), int(received[0]) + len(received))]
    assert lines.said[-1] == "relaying 1 of 2 topics; nobody publishes /never yet"


def test_it_matches_a_best_effort_source(ros, lines, eventually):
    """A best-effort sensor is relayed too: a reliable reader would not match it."""
    sensor = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    talker = ros.node("sensor").create_publisher(String, "/chatter", sensor)
    Relay(ros.node("relay"), RelaySettings(topics=("/chatter",)), on_change=lines)
    eventually(lambda: talker.get_subscription_count() == 1)


def test_a_type_that_is_not_installed_is_named():
    """A message type nobody installed is refused by name."""
    with pytest.raises(UnknownTypeError, match="no_such_msgs/msg/Thing is not installed"):
        message_class("no_such_msgs/msg/Thing")


def test_the_cheap_executor_is_taken_where_it_delivers(ros):
    """EventsExecutor delivers here, and is what the relay runs on."""
    executor = best_executor(context=ros.context)
    assert type(executor).__name__ == "EventsExecutor"
    executor.shutdown()


def test_an_executor_that_delivers_nothing_is_not_trusted(ros, monkeypatch):
    """Where EventsExecutor never delivers, the relay runs on rclpy's default executor."""
    monkeypatch.setattr("rclpy.experimental.EventsExecutor", DeafExecutor)
    executor = best_executor(context=ros.context)
    assert type(executor).__name__ == "SingleThreadedExecutor"
    executor.shutdown()


def test_a_latched_topic_stays_latched(ros, lines, eventually):
    """A late reader of the relayed topic gets the map that was published before it came."""
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    talker = ros.node("map_server").create_publisher(String, "/map", latched)
    talker.publish(String(data="the map"))
    Relay(ros.node("relay"), RelaySettings(topics=("/map",)), on_change=lines)
    eventually(lambda: lines.said[-1] == "relaying 1 of 1 topics")
    time.sleep(0.5)
    received = []
    ros.node("late").create_subscription(String, "/link/map", lambda m: received.append(m.data), latched)
    eventually(lambda: received == ["the map"])
