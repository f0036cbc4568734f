"""`arpd topics` on two computers: what the other one publishes does not cross the link to be measured."""

import json
import os
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from scripts.netns.simlink import SimLink, available

pytestmark = pytest.mark.skipif(not available()[0], reason=available()[1])

REPO = Path(__file__).resolve().parents[2]
NODE = """
import sys, rclpy
from std_msgs.msg import UInt8MultiArray
rclpy.init()
name, written, read = sys.argv[1:4]
node = rclpy.create_node(name)
publisher = node.create_publisher(UInt8MultiArray, written, 10)
node.create_timer(0.05, lambda: publisher.publish(UInt8MultiArray(data=bytes(20_000))))
node.create_subscription(UInt8MultiArray, read, lambda _sample: None, 10)
print("ready", flush=True)
rclpy.spin(node)
"""


@pytest.fixture
def two_computers():
    """Yield a link, and a function that starts a Python process on one of its hosts."""
    with SimLink(f"topics-{time.monotonic_ns() % 10**9}") as wire:

        def start(host, *argv):
            environment = {**os.environ, "PYTHONPATH": str(REPO)}
            return wire.popen(host, [sys.executable, *argv], stdout=-1, text=True, env=environment, cwd=REPO)

        yield wire, start


def test_topics_of_the_other_computer_do_not_cross_to_be_measured(two_computers):
    """The robot's topic is measured; the CEDDP's, which nobody on the robot reads, stays where it is."""
    wire, start = two_computers
    nodes = [
        start("robot", "-c", NODE, "camera", "/pictures", "/nothing"),
        start("ceddp", "-c", NODE, "planner", "/plans", "/nothing"),
    ]
    assert [node.stdout.readline().strip() for node in nodes] == ["ready", "ready"]
    begun_s, before = time.monotonic(), wire.counters()["robot"].rx_bytes
    command = start("robot", "-m", "arpd.cli", "topics", "--seconds", "4", "--json")
    out, _ = command.communicate(timeout=60)
    received = wire.counters()["robot"].rx_bytes - before

    found = {topic["name"]: topic for topic in json.loads(out)["topics"]}
    assert found["/pictures"]["traffic"]["rate_hz"] == pytest.approx(20, rel=0.2)
    assert (found["/pictures"]["writers"], found["/pictures"]["far_writers"]) == (["/camera"], [])
    assert (found["/plans"]["writers"], found["/plans"]["far_writers"]) == ([], ["/planner"])
    assert found["/plans"]["traffic"] is None
    assert found["/nothing"]["readers"] == ["/camera"]
    assert found["/nothing"]["far_readers"] == ["/planner"]
    # Discovery alone; a second of /plans has 400 kB.
    assert received < 200_000, (received, time.monotonic() - begun_s)
