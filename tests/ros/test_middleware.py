"""Publishers and graph on a middleware whose swaps were never measured; only its name is fake."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.adapters.ros.graph import GraphReader
from arpd.adapters.ros.rmw import current_rmw, rmw_of

pytestmark = pytest.mark.ros
OTHER = rmw_of("rmw_cyclonedds_cpp")


def test_the_middleware_here_is_one_that_is_swapped(ros):
    """Fast DDS is detected, with swaps."""
    assert current_rmw().can_swap


def test_an_unmeasured_middleware_is_paced_and_not_swapped(ros):
    """A new rate is in force at once, the depth stays, and the announcement says why."""
    publisher = AdaptivePublisher(ros.node("talker"), String, "/x", 10)
    publisher._rmw = OTHER
    publisher.retune(replace(publisher.plan, depth=20, rate_hz=3.0))
    state = publisher.state(generation=1)
    assert (state.depth, state.rate_hz) == (10, 3.0)
    assert state.refusal == OTHER.refusal
    publisher.retune(replace(publisher.plan, depth=10))
    assert not publisher.state(generation=1).refusal


def test_the_graph_is_read_without_hosts(ros, eventually):
    """Without hosts in GIDs, a topic whose reader is in its writer's process is local, as on Fast DDS."""
    node = ros.node("talker")
    node.create_publisher(String, "/x", 10)
    ros.node("listener").create_subscription(String, "/x", lambda _m: None, 10)
    eventually(lambda: node.count_subscribers("/x") == 1)
    assert GraphReader(node, OTHER).read().crossings["/x"] == GraphReader(node, current_rmw()).read().crossings["/x"]
