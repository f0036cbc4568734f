"""The daemon drives a publisher and an AdaptiveSubscription, with real rclpy and Fast DDS."""

import math
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher, AdaptiveSubscription
from arpd.adapters.ros.world import RosControl
from arpd.apply.endpoint.writer_swap import SwapTiming
from arpd.apply.ordering import Ordering
from arpd.apply.readers import plan_readers, restore_readers
from arpd.apply.transitions import restore_plan
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.settings import GraphSettings

pytestmark = pytest.mark.ros
TOPIC = "/driven"
DEPTH = 300  # at 50 Hz six seconds
MS = 1_000_000


class Planner:
    """Applies a plan as the daemon's tick does, through the daemon's own ROS side."""

    def __init__(self, node):
        self._control = RosControl(node, interface="lo", graph=GraphSettings(), on_report=lambda: None)
        self._ordering = Ordering()
        self._generation = 0
        self._row = None
        self.observation = self.steps = None

    def intend(self, deadline_ns, depth):
        self._row = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=deadline_ns, depth=depth)
        self._generation += 1
        self.steps = None

    def restore(self):
        self._row = None
        self._generation += 1
        self.steps = None

    def both_ends(self):
        """Return what was seen last if it has a publisher and a reader."""
        seen = self.observation
        return seen if seen is not None and seen.publishers and seen.readers else None

    def is_in_force(self):
        steps, seen = self.steps, self.both_ends()
        if steps is None or seen is None:
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
        )
        self._control.apply(steps.transitions, now_s=now_s)
        if generation == self._generation:
            self.steps = steps


@pytest.fixture
def planner(ros, background):
    made = Planner(ros.node("arpd"))
    background(made.work)
    return made


def test_a_plan_moves_both_ends_of_a_topic_and_nothing_is_lost(ros, planner, background, eventually):
    """Under 50 Hz two relaxed plans, a tightened one and a restore lose no sample, and no reader is refused."""
    refused, heard, sent = [], [], 0
    publisher = AdaptivePublisher(
        ros.node("talker"),
        String,
        TOPIC,
        QoSProfile(depth=DEPTH, deadline=Duration(nanoseconds=80 * MS)),
        event_callbacks=PublisherEventCallbacks(incompatible_qos=refused.append),
        swap_timing=SwapTiming(settle_s=0.1),
    )
    AdaptiveSubscription(
        ros.node("listener"),
        String,
        TOPIC,
        lambda message: heard.append(int(message.data)),
        QoSProfile(depth=DEPTH, deadline=Duration(nanoseconds=100 * MS)),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=refused.append),
    )

    def talk(stopping):
        nonlocal sent
        while not stopping.wait(0.02):
            publisher.publish(String(data=str(sent)))
            sent += 1

    eventually("publisher and reader match", lambda: publisher.get_subscription_count() == 1)
    background(talk)
    for deadline_ns, depth in ((500 * MS, DEPTH + 100), (80 * MS, DEPTH + 50), (400 * MS, DEPTH + 10)):
        planner.intend(deadline_ns, depth)
        eventually("the plan is in force", planner.is_in_force)
        (talker,), (reader,) = planner.observation.publishers, planner.observation.readers
        assert (talker.deadline_ns, talker.depth) == (deadline_ns, depth)
        assert (reader.deadline_ns, reader.depth) == (deadline_ns * 3 // 2, depth)
    planner.restore()
    eventually("the ends have their own QoS", planner.is_in_force)
    (reader,) = planner.observation.readers
    assert (reader.depth, reader.deadline_ns) == (DEPTH, 100 * MS)
    so_far = sent
    eventually("all samples so far arrive", lambda: heard[-1] >= so_far)
    numbers = list(heard)
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert refused == []
