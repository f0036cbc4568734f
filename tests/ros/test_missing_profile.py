"""A process with AdaptivePublishers and without arpd's Fast DDS profile says so, once."""

import os
import subprocess
import sys
from pathlib import Path

from arpd.ros.runtime import PROFILE_VARIABLES
from tests.ros.domain import DOMAIN

REPO = Path(__file__).parents[2]
PROCESS = """
import sys, time
import rclpy
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import String, UInt8MultiArray
from arpd import AdaptivePublisher
from arpd.ros.names import PUBLISHERS_TOPIC
from arpd.ros.snapshot_decoder import decode_snapshot

rclpy.init()
nodes = [rclpy.create_node(name) for name in ("one", "two")]
publishers = [AdaptivePublisher(node, String, f"/{node.get_name()}", 5) for node in nodes]
heard = {}
def hear(message):
    heard.update({row["topic"]: row["lacks_profile"] for row in decode_snapshot(bytes(message.data)).publishers})
qos = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
nodes[0].create_subscription(UInt8MultiArray, PUBLISHERS_TOPIC, hear, qos)
until_s = time.monotonic() + 60.0
while len(heard) < 2 and time.monotonic() < until_s:
    for node in nodes:
        rclpy.spin_once(node, timeout_sec=0.05)
print(sorted(heard.items()))
rclpy.try_shutdown()
"""


def test_a_process_without_the_profile_says_so_once(tmp_path):
    """Of two nodes one warns, with the line that mends it; both announce it."""
    environment = {name: value for name, value in os.environ.items() if name not in PROFILE_VARIABLES}
    environment |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = subprocess.run(
        [sys.executable, "-c", PROCESS],
        env=environment | {"PYTHONPATH": os.pathsep.join([str(REPO), *filter(None, [os.environ.get("PYTHONPATH")])])},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.strip() == "[('/one', True), ('/two', True)]"
    assert done.stderr.count("export FASTRTPS_DEFAULT_PROFILES_FILE=") == 1, done.stderr
