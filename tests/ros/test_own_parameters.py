"""ParameterEvents, plans and parameter services of a node with arpd's parameters, with real rclpy."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import String

from arpd import AdaptivePublisher

pytestmark = pytest.mark.ros
TOPICS = [f"/topic{number}" for number in range(20)]
DEPTH = "qos_overrides./topic0.publisher.depth"


@pytest.fixture
def node(ros):
    return ros.node("talker")


def test_the_parameter_services_know_them_as_ever(ros, node, eventually):
    """`ros2 param list`, `get`, `describe` and `set` work for arpd's parameters."""
    publisher = AdaptivePublisher(node, String, TOPICS[0], 10)
    client = AsyncParameterClient(ros.node("tool"), "/talker")
    eventually("the services are there", client.services_are_ready)

    def answer(future):
        eventually("the service answers", future.done)
        return future.result()

    assert DEPTH in answer(client.list_parameters()).result.names
    assert [value.integer_value for value in answer(client.get_parameters([DEPTH])).values] == [10]
    assert "KEEP_LAST" in answer(client.describe_parameters([DEPTH])).descriptors[0].description
    assert answer(client.set_parameters([Parameter(DEPTH, value=12)])).results[0].successful
    assert publisher.plan.depth == 12
