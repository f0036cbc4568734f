"""Two ends over a real link: nothing but arpd may be on it."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.netns.simlink import SimLink, available
from tests.waiting import eventually

pytestmark = pytest.mark.skipif(not available()[0], reason=available()[1])

REPO = Path(__file__).resolve().parents[2]
TALKER = """
import time, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/chatter", 10)
while True:
    publisher.publish(String(data="x"))
    time.sleep(0.1)
"""


@pytest.fixture
def link(tmp_path):
    """Yield a link, and a function that starts a Python process on one of its hosts."""
    (tmp_path / "arpd.yaml").write_text("relay:\n  link_domain: 102\n  robot: 10.77.0.1\n  ceddp: 10.77.0.2\n")
    with SimLink(f"ends-{time.monotonic_ns() % 10**9}") as wire:

        def start(host, name, *argv, reach="LOCALHOST"):
            log = (tmp_path / f"{name}.log").open("w")
            environment = ["env", f"PYTHONPATH={REPO}", f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}"]
            return wire.popen(host, [*environment, sys.executable, "-u", *argv], stderr=log, stdout=subprocess.DEVNULL)

        yield wire, start


def ends(start, folder):
    config = str(folder / "arpd.yaml")
    start("robot", "near", "-m", "arpd.cli", "relay", "--config", config)
    start("ceddp", "far", "-m", "arpd.cli", "relay", "--config", config, "--far")


@pytest.mark.parametrize(("reach", "is_seen"), [("SUBNET", True), ("LOCALHOST", False)])
def test_a_node_that_announces_itself_on_the_link_is_named(link, tmp_path, reach, is_seen):
    """A node of the robot that announces itself on the link is refused by name; a confined one is not."""
    _wire, start = link
    ends(start, tmp_path)
    start("robot", "talker", "-c", TALKER, reach=reach)
    log = tmp_path / "far.log"
    words = "cannot carry /chatter: /talker of the other side is visible in this domain without the relay"
    eventually(lambda: "the other end is" in log.read_text(), timeout_s=40)
    if is_seen:
        eventually(lambda: words in log.read_text(), timeout_s=40)
    else:
        time.sleep(8.0)  # two announcements
        assert words not in log.read_text()
