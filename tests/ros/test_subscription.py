"""AdaptiveSubscription with real rclpy and Fast DDS on this host."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String

from arpd import AdaptiveSubscription
from tests.ros.setter import Setter

pytestmark = pytest.mark.ros
TOPIC = "/heard"
DEEP = 2000  # at 200 Hz ten seconds
EXECUTORS = [SingleThreadedExecutor, MultiThreadedExecutor, EventsExecutor]


class Talker:
    """Writes consecutive numbers."""

    def __init__(self, node, qos=5000):
        self.publisher, self.sent = node.create_publisher(String, TOPIC, qos), 0

    def at(self, rate_hz):
        def work(stopping):
            while not stopping.wait(1 / rate_hz):
                self.say()

        return work

    def say(self):
        self.publisher.publish(String(data=str(self.sent)))
        self.sent += 1


@pytest.fixture
def talker(ros):
    return Talker(ros.node("talker"))


def setter(subscription):
    return Setter(subscription._node, TOPIC, "subscription")


@pytest.fixture
def hear(ros):
    """Make an AdaptiveSubscription in a node of its own, and what it received."""

    def make(qos=DEEP, executor=SingleThreadedExecutor, **options):
        received = []
        node = ros.node("listener", executor(context=ros.context))
        subscription = AdaptiveSubscription(node, String, TOPIC, received.append, qos, **options)
        return subscription, received

    return make


def numbers(received):
    return [int(message.data) for message in received]


def match(talker, subscription, eventually):
    eventually("the publisher matches", lambda: talker.publisher.get_subscription_count() == 1)
    eventually("the subscription matches", lambda: subscription.get_publisher_count() == 1)


def done(subscription):
    return sum(subscription.state().swaps_by_result.values())


@pytest.mark.parametrize("executor", EXECUTORS)
def test_swaps_lose_double_and_reorder_nothing(talker, hear, background, eventually, executor):
    """Three swaps under 200 Hz deliver every message once and in order."""
    subscription, received = hear(executor=executor)
    match(talker, subscription, eventually)
    background(talker.at(200))
    for k in range(3):
        subscription.renew(replace(subscription.qos, depth=DEEP + 1 + k))
        eventually("the new depth is in force", lambda k=k: subscription.state().depth == DEEP + 1 + k)
    so_far = talker.sent
    eventually("all samples so far arrive", lambda: received and numbers(received)[-1] >= so_far)
    heard = numbers(received)
    assert heard == list(range(heard[0], heard[-1] + 1))
    assert done(subscription) == 3


@pytest.mark.parametrize("executor", EXECUTORS)
def test_a_callback_may_ask_for_message_info(ros, talker, eventually, executor):
    """Message and MessageInfo reach a callback of two arguments on every executor."""
    received = []
    node = ros.node("listener", executor(context=ros.context))
    subscription = AdaptiveSubscription(node, String, TOPIC, lambda *pair: received.append(pair), 10)
    assert subscription.callback
    subscription.callback = lambda message, info: received.append((message.data, info["publication_sequence_number"]))
    match(talker, subscription, eventually)
    talker.say()
    eventually("message and info arrive", lambda: received == [("0", 1)])


def test_a_latched_subscription_is_not_swapped(hear):
    """A TRANSIENT_LOCAL reader stays: a new one would receive the history again."""
    subscription, _ = hear(qos=QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    result = setter(subscription)(depth=5)
    assert not result.successful
    assert "TRANSIENT_LOCAL" in result.reason
