"""The nodes of one host of a link; they print what reaches them, until they are killed.

Usage: host_nodes.py robot | base

The robot numbers samples on /odom and serves /add; the base computer numbers commands on /cmd and calls /add. Pictures
on /picture say which sample was the last before them.
"""

import sys

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String, UInt8MultiArray
from test_msgs.srv import BasicTypes

from arpd.ros.runtime import FASTDDS_PROFILE, prepare_environment

PERIOD_S = 0.02
DEEP = QoSProfile(depth=500)  # ten seconds of samples
PICTURE_BYTES = 400_000


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
    return sent


def picture(node, sent):
    """Publish a large sample every second."""
    publisher = node.create_publisher(UInt8MultiArray, "/picture", 1)
    noise = bytes(k * k % 251 for k in range(PICTURE_BYTES))
    node.create_timer(1.0, lambda: publisher.publish(UInt8MultiArray(data=sent[0].to_bytes(4) + noise)))


def look(picture):
    data = bytes(picture.data)
    whole = all(data[4 + k] == k * k % 251 for k in range(PICTURE_BYTES))
    say("/picture" if whole and len(data) == PICTURE_BYTES + 4 else "/torn", int.from_bytes(data[:4]))


def hear(node, topic):
    node.create_subscription(String, topic, lambda sample: say(topic, sample.data), DEEP)


def add(request, response):
    response.uint64_value = request.uint64_value + 1
    return response


prepare_environment(FASTDDS_PROFILE)
rclpy.init()
node = rclpy.create_node(f"{sys.argv[1]}_node")
if sys.argv[1] == "robot":
    picture(node, number(node, "/odom"))
    hear(node, "/cmd")
    node.create_service(BasicTypes, "/add", add)
    rclpy.spin(node)
number(node, "/cmd")
hear(node, "/odom")
node.create_subscription(UInt8MultiArray, "/picture", look, 1)
client = node.create_client(BasicTypes, "/add")
while not client.service_is_ready():
    rclpy.spin_once(node, timeout_sec=PERIOD_S)
answer = client.call_async(BasicTypes.Request(uint64_value=41))
while not answer.done():
    rclpy.spin_once(node, timeout_sec=PERIOD_S)
say("/add", answer.result().uint64_value)
rclpy.spin(node)
