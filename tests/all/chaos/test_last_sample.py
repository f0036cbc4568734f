"""A program that ends, and what it published last."""

import os
import subprocess
import sys
from contextlib import ExitStack

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from tests.ros.ends_world import listen
from tests.ros.world import DOMAIN, REPO, Ros
from tests.waiting import PATIENCE_S, eventually

TOPIC = "/operator"
OPERATOR = f"""
import os, signal, time, rclpy
from rclpy.duration import Duration
from std_msgs.msg import String
from arpd import AdaptivePublisher
from arpd.model.plan import TopicPlan

rclpy.init()
node = rclpy.create_node("operator")
publisher = AdaptivePublisher(node, String, "{TOPIC}", 10)
publisher.retune(TopicPlan(rate_hz=1e-3, min_rate_hz=0.0, deadline_ns=0, depth=10))
while not publisher.get_subscription_count():
    time.sleep(0.01)
publisher.publish(String(data="begin"))
# The reader matches later than its count says, and what comes before is sent again by a writer that lives.
assert publisher.wait_for_all_acked(Duration(seconds=30))
for word in ("go on", "go on", "stop"):
    publisher.publish(String(data=word))
# As Ctrl-C comes, while it spins: rclpy's `spin` fails if its context ends while it makes its executor, or a wait set.
node.create_timer(0.01, lambda: os.kill(os.getpid(), signal.SIGINT))
try:
    rclpy.spin(node)
except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
    pass
except RuntimeError:
    assert not rclpy.ok()
"""


def test_the_last_sample_leaves_after_a_signal():
    """A program that ends by Ctrl-C, and destroys no node, takes nothing with it."""
    with ExitStack() as stack:
        received = listen(Ros(stack).node("robot"), TOPIC)
        # What waits in the shared memory of a process that ends goes with it; a packet has left.
        udp = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
        variables = os.environ | udp | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(REPO)}
        subprocess.run([sys.executable, "-c", OPERATOR], env=variables, timeout=2 * PATIENCE_S, check=True)
        eventually("the last one arrives", lambda: received[-1:] == ["stop"])
