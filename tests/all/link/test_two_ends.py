"""Two ends over a real link: nothing but arpd may be on it."""

import os
import subprocess

from scripts.netns.simlink import SimLink
from tests.all.link.hosts import NEEDS_LINK, python
from tests.waiting import eventually

pytestmark = NEEDS_LINK

TALKER = """
import sys, time, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node(sys.argv[1])
publisher = node.create_publisher(String, "/" + sys.argv[2], 10)
while True:
    publisher.publish(String(data="x"))
    time.sleep(0.1)
"""
REFUSED = "cannot carry /{}: /{} of the other side is visible in this domain without the relay"


def test_a_node_that_announces_itself_on_the_link_is_named(tmp_path):
    """A node of the robot that announces itself on the link is refused by name; a confined one is not."""
    (tmp_path / "arpd.yaml").write_text("relay:\n  link_domain: 102\n  robot: 10.77.0.1\n  base: 10.77.0.2\n")
    with SimLink(f"ends-{os.getpid()}") as link, (tmp_path / "log").open("w") as log:

        def start(host, *argv, reach="LOCALHOST"):
            environment = [f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}"]
            python(link, host, *argv, environment=environment, stderr=log, stdout=subprocess.DEVNULL)

        def told():
            return (tmp_path / "log").read_text()

        relay = ("-m", "arpd.cli", "relay", "--config", str(tmp_path / "arpd.yaml"))
        start("robot", *relay)
        start("base", *relay, "--far")
        start("robot", "-c", TALKER, "whisperer", "whispers")
        eventually("both ends meet", lambda: told().count("the other end is") >= 2)
        start("robot", "-c", TALKER, "crier", "cries", reach="SUBNET")
        eventually("the node on the link is named", lambda: REFUSED.format("cries", "crier") in told())
        assert "/whispers" not in told()
