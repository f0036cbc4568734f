"""Messages that `tests.messages.generate` makes are ROS messages like any other."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import TransformStamped

pytestmark = pytest.mark.ros

#: As `ros2 topic info --verbose /tf` shows it on a robot with Jazzy.
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


def transform(number):
    stamped = TransformStamped(child_frame_id=f"wheel {number}")
    stamped.header.frame_id = "base"
    stamped.header.stamp.nanosec = number
    stamped.transform.translation.x = 0.1 * number
    return stamped


@pytest.mark.parametrize("count", [0, 3])
def test_a_published_message_arrives_equal(ros, tf_message, eventually, count):
    """Transforms cross from one participant to another, with every field, as the type that every robot announces."""
    received = []
    ros.node("far").create_subscription(tf_message, "/tf", received.append, 10)
    node = ros.node("near")
    publisher = node.create_publisher(tf_message, "/tf", 10)
    sent = tf_message(transforms=[transform(number) for number in range(count)])
    eventually("the reader matches", lambda: publisher.get_subscription_count() == 1)
    publisher.publish(sent)
    eventually("the message arrives", lambda: received)
    assert received == [sent]
    (info,) = eventually("the writer shows", lambda: node.get_publishers_info_by_topic("/tf"))
    assert (info.topic_type, str(info.topic_type_hash)) == ("tf2_msgs/msg/TFMessage", HASH)
