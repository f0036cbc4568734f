"""A process with one AdaptiveSubscription; it prints the numbers it received as JSON when its input ends."""

import json
import sys

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptiveSubscription
from arpd.adapters.ros.runtime import prepare_environment, spinning

prepare_environment()
rclpy.init()
node = rclpy.create_node("listener")
heard, incompatible = [], []
events = SubscriptionEventCallbacks(incompatible_qos=lambda event: incompatible.append(event.total_count))
qos = QoSProfile(depth=int(sys.argv[2]), deadline=Duration(nanoseconds=int(sys.argv[3])))
subscription = AdaptiveSubscription(
    node, String, sys.argv[1], lambda message: heard.append(int(message.data)), qos, event_callbacks=events
)
executor = SingleThreadedExecutor()
executor.add_node(node)
with spinning(executor):
    sys.stdin.read()
state = subscription.state()
print(
    json.dumps(
        {
            "heard": heard,
            "incompatible": incompatible,
            "depth": state.depth,
            "deadline_ns": state.deadline_ns,
            "swaps": state.swaps_by_result,
        }
    )
)
rclpy.try_shutdown()
