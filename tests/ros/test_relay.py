"""The relay with real rclpy: unmodified publishers in, AdaptivePublishers out."""

import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String

from arpd.ros.relay import Relay, UnknownTypeError, best_executor, message_class
from arpd.settings import RelaySettings

pytestmark = pytest.mark.ros


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


def test_the_executor_was_seen_to_deliver(ros):
    """The relay's executor has delivered a message to itself, or it is rclpy's default one."""
    executor = best_executor(context=ros.context)
    try:
        assert type(executor).__name__ in {"EventsExecutor", "SingleThreadedExecutor"}
    finally:
        executor.shutdown()
