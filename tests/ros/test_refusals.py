"""What a publisher that cannot take a plan announces, and what the daemon makes of it: real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.apply.transitions import is_confirmed
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import TopicPlan

pytestmark = pytest.mark.ros
ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=500_000_000, depth=40)


def announced(publisher):
    return publisher.state(generation=1)


def test_a_latched_publisher_is_settled_by_its_rate(ros):
    """A TRANSIENT_LOCAL topic refuses new QoS for good, by name; with the rate the plan is in force."""
    latched = QoSProfile(depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    publisher = AdaptivePublisher(ros.node("talker"), String, "/map", latched)
    assert announced(publisher).refusal_reason is RefusalReason.NONE
    publisher.retune(ROW)
    state = announced(publisher)
    assert (state.refusal_reason, state.depth) == (RefusalReason.TRANSIENT_LOCAL, 3)
    assert is_confirmed(state, ROW)


def test_a_clamped_publisher_may_be_asked_again(ros, eventually):
    """A deadline that a reader does not allow now is a refusal that may pass."""
    strict = QoSProfile(depth=3, deadline=Duration(nanoseconds=100_000_000))
    ros.node("reader").create_subscription(String, "/scan", lambda _m: None, strict)
    publisher = AdaptivePublisher(ros.node("talker"), String, "/scan", strict)
    eventually(lambda: publisher.get_subscription_count() == 1)
    publisher.retune(ROW)
    state = announced(publisher)
    assert (state.refusal_reason, state.refusal_reason.is_lasting) == (RefusalReason.CLAMPED, False)
    assert not is_confirmed(state, ROW)


def test_a_publisher_that_keeps_all_gets_no_writer_for_a_depth(ros, eventually):
    """Where the history is KEEP_ALL a new depth makes no swap, a new deadline one, and the plan is in force."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/all", QoSProfile(history=QoSHistoryPolicy.KEEP_ALL))
    publisher.retune(TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=40))
    assert not publisher._flow._swap.is_busy
    publisher.retune(ROW)
    eventually(lambda: is_confirmed(announced(publisher), ROW))
    assert sum(announced(publisher).swaps_by_result.values()) == 1
