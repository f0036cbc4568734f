"""The nodes of one host of a link; they print what reaches them, until they are killed.

Usage: host_nodes.py robot | base

The robot numbers samples on /odom and serves /add; the base computer numbers commands on /cmd and calls /add.
"""

import sys

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from test_msgs.srv import BasicTypes

from arpd.adapters.ros.runtime import prepare_environment

PERIOD_S = 0.02
DEEP = QoSProfile(depth=500)  # ten seconds of samples


def say(*words):
    print(*words, flush=True)


def number(node, topic):
    """Publish consecutive numbers while somebody reads them."""
    publisher, sent = node.create_publisher(String, topic, DEEP), [0]

    def publish():
        if publisher.get_subscription_count():
            publisher.publish(String(data=str(sent[0])))
            sent[0] += 1

    node.create_timer(PERIOD_S, publish)


def hear(node, topic):
    node.create_subscription(String, topic, lambda sample: say(topic, sample.data), DEEP)


def add(request, response):
    response.uint64_value = request.uint64_value + 1
    return response


prepare_environment()
rclpy.init()
node = rclpy.create_node(f"{sys.argv[1]}_node")
if sys.argv[1] == "robot":
    number(node, "/odom")
    hear(node, "/cmd")
    node.create_service(BasicTypes, "/add", add)
    rclpy.spin(node)
number(node, "/cmd")
hear(node, "/odom")
client = node.create_client(BasicTypes, "/add")
while not client.service_is_ready():
    rclpy.spin_once(node, timeout_sec=PERIOD_S)
answer = client.call_async(BasicTypes.Request(uint64_value=41))
while not answer.done():
    rclpy.spin_once(node, timeout_sec=PERIOD_S)
say("/add", answer.result().uint64_value)
rclpy.spin(node)
