"""Reads the topic of tests/all/system/user_node.py on the other end of the link."""

import rclpy
from std_msgs.msg import String

from tests.all.system.user_node import TOPIC


def main():
    rclpy.init()
    node = rclpy.create_node("listener")
    node.create_subscription(String, TOPIC, lambda _: None, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
