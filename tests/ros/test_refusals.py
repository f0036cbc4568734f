"""Announcements of publishers that cannot take a plan, with real rclpy."""

from dataclasses import replace

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.govern.progress import is_confirmed
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import TopicPlan

ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=500_000_000, depth=40)


def test_a_latched_publisher_is_settled_by_its_rate(ros):
    """A TRANSIENT_LOCAL topic refuses new QoS and names the way out; its rate confirms the plan."""
    latched = QoSProfile(depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    publisher = AdaptivePublisher(ros.node("talker"), String, "/map", latched)
    assert publisher.state().refusal_reason is RefusalReason.NONE
    publisher.retune(ROW)
    state = publisher.state()
    assert (state.refusal_reason, state.depth, state.rate_hz) == (RefusalReason.TRANSIENT_LOCAL, 3, 5.0)
    assert "swap_transient_local" in state.refusal
    assert is_confirmed(state, ROW)
    publisher.retune(replace(ROW, depth=3, deadline_ns=0))
    assert not publisher.state().refusal


def test_a_publisher_that_keeps_all_gets_no_writer_for_a_depth(ros, eventually):
    """With KEEP_ALL a new depth makes no swap, a new deadline makes one, and the plan is confirmed."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/all", QoSProfile(history=QoSHistoryPolicy.KEEP_ALL))
    publisher.retune(TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=40))
    assert not publisher._flow._swap.is_busy
    publisher.retune(ROW)
    eventually("the plan is confirmed", lambda: is_confirmed(publisher.state(), ROW))
    eventually("the swap ends", lambda: not publisher._flow._swap.is_busy)
    assert sum(publisher.state().swaps_by_result.values()) == 1
