"""Ghost nodes that two threads use at once, on real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from arpd.adapters.ros.ends.ghosts import GhostNodes

pytestmark = pytest.mark.ros


def test_a_ghost_in_use_outlives_the_look_of_another_owner(ros):
    """An owner destroys no ghost that another one has just taken, and the last owner that lets go destroys it."""
    nodes = GhostNodes(ros.node("end"))
    publisher = nodes.of("/sensor", owner="topics").create_publisher(String, "/chatter", 1)
    nodes.keep("services", set())
    assert publisher.get_subscription_count() == 0  # a destroyed one raises InvalidHandle
    nodes.of("/sensor", owner="services")
    nodes.keep("topics", {"/sensor"})
    nodes.keep("services", set())
    publisher.get_subscription_count()
    nodes.keep("topics", set())
    with pytest.raises(RuntimeError, match="destruction was requested"):
        publisher.get_subscription_count()
    nodes.close()
