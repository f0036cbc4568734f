"""Ghost nodes that two threads use at once, on real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
pytest.importorskip("test_msgs", reason="test_msgs is not installed")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from std_msgs.msg import String
from test_msgs.srv import Empty

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


@pytest.mark.parametrize("make_executor", [SingleThreadedExecutor, EventsExecutor])
def test_a_ghost_that_topics_keep_serves_calls_again(ros, eventually, make_executor):
    """Calls lose their ghost while the other end is unreachable, and then it is in the executor again."""
    user = ros.node("user")
    client = user.create_client(Empty, "/serve")
    executor = make_executor(context=ros.context)
    end = rclpy.create_node("end", context=ros.context)
    executor.add_node(end)
    nodes = GhostNodes(end)
    nodes.of("/server", owner="topics")

    def spun_until(condition):
        executor.spin_once(timeout_sec=0.01)
        return condition()

    for _ in range(3):
        ghost = nodes.served("/server", owner="services")
        service = ghost.create_service(Empty, "/serve", lambda _, answer: answer)
        eventually("the service is there", client.service_is_ready)
        future = client.call_async(Empty.Request())
        eventually("the call is answered", lambda answer=future: spun_until(answer.done))
        ghost.destroy_service(service)
        nodes.release("services", set())
        eventually("the service is gone", lambda: spun_until(lambda: not client.service_is_ready()))
    nodes.close()
    end.destroy_node()
    executor.shutdown()
