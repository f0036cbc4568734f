"""A process with AdaptivePublishers and without arpd's Fast DDS profile says so, once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.runtime import FASTDDS_PROFILE, PROFILE_VARIABLES
from tests.ros.domain import DOMAIN

pytestmark = pytest.mark.ros
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


def run(tmp_path, **variables):
    """Run a process with two nodes; return what it announces, and what it logs."""
    environment = {name: value for name, value in os.environ.items() if name not in PROFILE_VARIABLES}
    environment |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **variables}
    done = subprocess.run(
        [sys.executable, "-c", PROCESS],
        env=environment | {"PYTHONPATH": os.pathsep.join([str(REPO), *filter(None, [os.environ.get("PYTHONPATH")])])},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.strip(), done.stderr


def test_a_process_without_the_profile_says_so_once(tmp_path):
    """Of two nodes one warns, with the line that mends it; both announce it."""
    announced, log = run(tmp_path)
    assert announced == "[('/one', True), ('/two', True)]"
    assert log.count("export FASTRTPS_DEFAULT_PROFILES_FILE=") == 1, log


def test_a_process_with_the_profile_says_nothing(tmp_path):
    """It neither warns nor announces anything."""
    announced, log = run(tmp_path, **{PROFILE_VARIABLES[0]: str(FASTDDS_PROFILE)})
    assert announced == "[('/one', False), ('/two', False)]"
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in log
