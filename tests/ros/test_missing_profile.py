"""A process with AdaptivePublishers and without arpd's Fast DDS profile says so, once."""

import os
import subprocess
import sys

from arpd.ros.runtime import PROFILE_VARIABLE
from tests.ros.world import DOMAIN, REPO

PROCESS = """
import rclpy
from std_msgs.msg import String
from arpd import AdaptivePublisher

rclpy.init()
nodes = [rclpy.create_node(name) for name in ("one", "two")]
publishers = [AdaptivePublisher(node, String, f"/{node.get_name()}", 5) for node in nodes]
print([publisher._shared._lacks_profile for publisher in publishers])
rclpy.try_shutdown()
"""


def test_a_process_without_the_profile_says_so_once(environment, tmp_path):
    """Of two nodes one warns, with the line that mends it; both tell the daemon."""
    variables = {name: value for name, value in os.environ.items() if name != PROFILE_VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", PROCESS],
        env=variables | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(REPO)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "[True, True]" in done.stdout.splitlines()
    assert done.stderr.count("export FASTRTPS_DEFAULT_PROFILES_FILE=") == 1, done.stderr
