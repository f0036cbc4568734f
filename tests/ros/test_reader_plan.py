"""The daemon drives a publisher, and an AdaptiveSubscription in another process, with real rclpy and Fast DDS."""

import json
import math
import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher, AdaptiveSubscription
from arpd.adapters.ros.announcement import reader_from_status
from arpd.adapters.ros.node_subscriptions import NodeSubscriptions
from arpd.adapters.ros.world import RosControl
from arpd.apply.ordering import Ordering
from arpd.apply.readers import plan_readers, restore_readers
from arpd.apply.transitions import restore_plan
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.settings import GraphSettings
from tests.chaos.world import is_gapless
from tests.ros.child import child
from tests.ros.price import PriceSender
from tests.ros.setter import Setter

pytestmark = pytest.mark.ros
TOPIC = "/driven"
LISTENER_DEPTH = 100  # at 50 Hz two seconds, because a busy machine may stop a process for several 0.1 s
MS = 1_000_000


class Planner:
    """Applies a plan as the daemon's tick does, through the daemon's own ROS side."""

    def __init__(self, node):
        self._control = RosControl(node, interface="lo", graph=GraphSettings(), on_report=lambda: None)
        self._ordering = Ordering()
        self._generation = 0
        self._row = None
        self.lease_s = 0.0
        self.observation = self.steps = None

    def intend(self, deadline_ns, depth):
        self._row = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=deadline_ns, depth=depth)
        self._generation += 1
        self.steps = None

    def restore(self):
        self._row = None
        self._generation += 1
        self.steps = None

    def is_in_force(self):
        steps, seen = self.steps, self.observation
        if steps is None or not seen.publishers or not seen.readers:
            return False
        return (steps.confirmed, steps.readers_confirmed) == (len(seen.publishers), len(seen.readers))

    def work(self, stopping):
        while not stopping.wait(0.1):
            if self._generation:
                self._tick(self._row, self._generation)

    def _tick(self, row, generation):
        now_s = time.monotonic()
        self.observation = seen = self._control.observe(now_s)
        plan = QosPlan(generation=generation, topics={TOPIC: row}, level_bytes_per_second=1.0) if row else None
        steps = self._ordering.steps(
            now_s,
            publishers=seen.publishers,
            readers=seen.readers,
            plan=plan or restore_plan(seen.publishers, generation=generation),
            reader_plans=plan_readers(seen.readers, plan) if plan else restore_readers(seen.readers),
            reason="test",
            lease_s=self.lease_s,
        )
        self._control.apply(steps.transitions, now_s=now_s)
        if generation == self._generation:
            self.steps = steps


@pytest.fixture
def planner(ros, background):
    made = Planner(ros.node("arpd"))
    background(made.work)
    return made


@pytest.fixture
def listener():
    with child("listener.py", TOPIC, LISTENER_DEPTH, 100 * MS) as process:
        yield process


def test_a_plan_moves_both_ends_of_a_topic_and_nothing_is_lost(ros, planner, listener, background, eventually):
    """Under 50 Hz two relaxed plans, a tightened one and a restore lose no sample, and no reader is refused."""
    refused = []
    publisher = AdaptivePublisher(
        ros.node("talker"),
        String,
        TOPIC,
        QoSProfile(depth=200, deadline=Duration(nanoseconds=80 * MS)),
        event_callbacks=PublisherEventCallbacks(incompatible_qos=lambda event: refused.append(event.total_count)),
    )
    sent = 0

    def talk(stopping):
        nonlocal sent
        while not stopping.wait(0.02):
            publisher.publish(String(data=str(sent)))
            sent += 1

    eventually(lambda: publisher.get_subscription_count() == 1)
    background(talk)
    for deadline_ns, depth in ((500 * MS, 300), (80 * MS, 250), (400 * MS, 200)):
        planner.intend(deadline_ns, depth)
        eventually(planner.is_in_force, timeout_s=30.0)
        (talker,), (reader,) = planner.observation.publishers, planner.observation.readers
        assert (talker.deadline_ns, talker.depth) == (deadline_ns, depth)
        assert (reader.deadline_ns, reader.depth) == (deadline_ns * 3 // 2, depth)
    planner.restore()
    eventually(planner.is_in_force, timeout_s=30.0)
    so_far = sent
    time.sleep(1.0)
    result = json.loads(listener.communicate(timeout=20)[0])
    assert is_gapless(result["heard"])
    assert result["heard"][-1] >= so_far
    assert (result["incompatible"], refused) == ([], [])
    assert (result["depth"], result["deadline_ns"]) == (LISTENER_DEPTH, 100 * MS)
    assert result["swaps"] == {"ok": 4}


def test_readers_that_cannot_change_say_so_and_are_left_alone(ros, planner, eventually):
    """A TRANSIENT_LOCAL reader announces a lasting refusal, and its request bounds the publisher."""
    node = ros.node("listener")
    latched = QoSProfile(
        depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL, deadline=Duration(nanoseconds=100 * MS)
    )
    AdaptiveSubscription(node, String, TOPIC, lambda _m: None, latched)
    AdaptivePublisher(ros.node("talker"), String, TOPIC, QoSProfile(depth=10))
    planner.intend(80 * MS, 20)
    eventually(lambda: planner.observation and planner.observation.readers and planner.observation.publishers)
    (reader,) = planner.observation.readers
    assert reader.refusal_reason is RefusalReason.TRANSIENT_LOCAL
    assert reader.refusal.startswith(f"{TOPIC} is TRANSIENT_LOCAL")
    eventually(lambda: planner.observation.publishers[0].requested_deadline_ns == 100 * MS)
    eventually(lambda: planner.observation.publishers[0].depth == 20)
    assert planner.observation.readers[0].depth == 3


def test_a_reader_outlives_its_daemon_only_as_long_as_was_granted(ros, planner, background, eventually):
    """The plan stays while the price comes; after the lease the reader has its own QoS again."""
    node = ros.node("listener")
    subscription = AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    send_price = PriceSender(ros.node("elsewhere"))
    is_sending = threading.Event()
    is_sending.set()

    def send(stopping):
        while not stopping.wait(0.1):
            if is_sending.is_set():
                send_price()

    background(send)
    planner.lease_s = 5.0
    planner.intend(80 * MS, 20)
    eventually(lambda: subscription.state().depth == 20)
    assert subscription.state().deadline_ns == 0, "its application requests none"
    planner.restore()
    planner._generation = 0  # the planner stops
    time.sleep(7.0)
    assert subscription.state().depth == 20
    is_sending.clear()
    eventually(lambda: subscription.state().depth == 10)
    eventually(lambda: node.get_parameter("arpd.readers.generation").value == 0)


def test_an_older_plan_is_refused(ros):
    """The readers of a node refuse a generation below the one in force."""
    node = ros.node("listener")
    AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    configure = Setter(ros.node("tuner"), "/listener", TOPIC, "subscription")
    assert configure(generation=5).successful
    assert not configure(generation=4).successful


def test_a_reader_that_changes_nothing_says_little(ros, monkeypatch):
    """News is announced every second; without news, only every third announcement is sent."""
    node = rclpy.create_node("quiet", context=ros.context)  # not spun: the test calls its timer
    subscription = AdaptiveSubscription(node, String, TOPIC, lambda _m: None, 10)
    shared, sent = NodeSubscriptions.of(node), []
    monkeypatch.setattr(shared, "_announcer", SimpleNamespace(publish=sent.append))

    def announcements(seconds):
        before = len(sent)
        for _ in range(seconds):
            shared._serve()
        return len(sent) - before

    assert announcements(3) == 3
    assert announcements(30) == 10
    node.set_parameters([Parameter("arpd.readers.generation", value=2)])
    assert announcements(1) == 1
    assert reader_from_status(sent[-1].status[0]).generation == 2
    subscription.destroy()
    assert announcements(9) == 0
    node.destroy_node()
