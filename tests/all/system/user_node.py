"""A user's own node: a plain script with an AdaptivePublisher."""

import rclpy
from std_msgs.msg import String

from arpd import AdaptivePublisher

TOPIC = "/chatter"
RATE_HZ = 20.0


def main():
    rclpy.init()
    node = rclpy.create_node("talker")
    publisher = AdaptivePublisher(node, String, TOPIC, 10)
    node.create_timer(1.0 / RATE_HZ, lambda: publisher.publish(String(data="x" * 500)))
    rclpy.spin(node)


if __name__ == "__main__":
    main()
