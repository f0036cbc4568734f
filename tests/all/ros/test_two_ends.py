"""The relay with two ends and many topics."""

from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from tests.ros.ends_world import Counter, TwoEnds

pytestmark = pytest.mark.ros


@pytest.fixture
def ends(ros, tmp_path):
    with ExitStack() as stack:
        yield TwoEnds(tmp_path, stack, ()).start()


def test_two_hundred_topics_are_wanted_at_once(ends, background, eventually):
    """When a reader of 200 topics comes, each of them arrives."""
    robot = ends.side("robot").node("robot")
    writers = [Counter(robot, String, f"/many/t{k}", 10) for k in range(200)]
    far, received = ends.side("base").node("rviz"), {}
    eventually("the topics show", lambda: far.count_publishers("/many/t199") == 1)
    for writer in writers:
        topic = writer.publisher.topic_name
        heard = received[topic] = []
        far.create_subscription(String, topic, heard.append, 10)

    def talk(stopping):
        while not stopping.wait(0.5):
            for writer in writers:
                writer.publish()

    background(talk)
    eventually("each topic arrives", lambda: all(received.values()))
