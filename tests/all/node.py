"""A user's node. Usage: node.py NAME PART…, with a PART like write:/chat:std_msgs/String:500, adapt:… or read:….

It publishes each topic 20 times a second, numbered if it is a String, which may have so many characters more. Of each
sample that it reads it says the topic and the number.
"""

import sys
from functools import partial
from importlib import import_module
from itertools import count

import rclpy
from rclpy.qos import QoSProfile

QOS = QoSProfile(depth=2000)  # RELIABLE, KEEP_LAST, 100 s


def created(node, what, made, topic):
    if what == "write":
        return node.create_publisher(made, topic, QOS)
    import arpd

    print(arpd.__file__, flush=True)
    return arpd.AdaptivePublisher(node, made, topic, QOS, overflow="queue")


def publish(publisher, made, size, numbers):
    publisher.publish(made(data=f"{next(numbers):08}" + "x" * size) if made.__name__ == "String" else made())


def say(topic, sample):
    print(topic, getattr(sample, "data", "")[:8], flush=True)


def main(name, *parts):
    rclpy.init()
    node = rclpy.create_node(name)
    for part in parts:
        what, topic, kind, *size = part.split(":")
        package, kind = kind.split("/")
        made = getattr(import_module(f"{package}.msg"), kind)
        if what == "read":
            node.create_subscription(made, topic, partial(say, topic), QOS)
        else:
            publisher = created(node, what, made, topic)
            node.create_timer(0.05, partial(publish, publisher, made, int(*size or "0"), count()))
    print("ready", flush=True)
    rclpy.spin(node)


main(*sys.argv[1:])
