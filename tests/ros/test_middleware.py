"""The graph and publishers on this middleware, and on one whose swaps were never measured; only its name is fake."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import Float64MultiArray, String

from arpd import AdaptivePublisher
from arpd.adapters.ros.graph import GraphReader
from arpd.adapters.ros.names import PRICE_TOPIC
from arpd.adapters.ros.rmw import current_rmw, rmw_of

pytestmark = pytest.mark.ros
OTHER = rmw_of("rmw_cyclonedds_cpp")


def test_an_unmeasured_middleware_is_paced_and_not_swapped(ros):
    """A new rate is in force at once, the depth stays, and the announcement says why."""
    assert current_rmw().can_swap
    publisher = AdaptivePublisher(ros.node("talker"), String, "/x", 10)
    publisher._rmw = OTHER
    publisher.retune(replace(publisher.plan, depth=20, rate_hz=3.0))
    state = publisher.state(generation=1)
    assert (state.depth, state.rate_hz) == (10, 3.0)
    assert state.refusal == OTHER.refusal
    publisher.retune(replace(publisher.plan, depth=10))
    assert not publisher.state(generation=1).refusal


def test_a_real_graph_is_followed(ros, eventually):
    """Writers and readers that come and go show in a real graph, on a middleware without hosts in its GIDs, too."""
    node = ros.node("arpd")
    node.create_publisher(Float64MultiArray, PRICE_TOPIC, 1)  # by which the daemon knows its host
    here, other = (GraphReader(node, rmw) for rmw in (current_rmw(), OTHER))

    def seen(graph=here):
        return graph.read().crossings.get("/x")

    talker = ros.node("talker").create_publisher(String, "/x", 10)
    eventually("the writer shows", lambda: seen() is not None and seen().writers == {"/talker"})
    ros.node("listener").create_subscription(String, "/x", lambda _m: None, 10)
    eventually("the reader shows", lambda: {node for node, _ in seen().requests} == {"/listener"})
    eventually("without hosts it is the same", lambda: seen(other) == seen())
    assert here.read().remote_participants == 0
    talker.destroy()
    eventually("the writer is gone", lambda: seen().writers == frozenset())
