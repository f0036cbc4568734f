"""`arpd topics` on two computers: what the other one publishes does not cross the link to be measured."""

import json
import os
import subprocess
from functools import partial

import pytest

from scripts.netns.simlink import SimLink
from tests.all.link.hosts import NEEDS_LINK, python

pytestmark = NEEDS_LINK

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
    with SimLink(f"topics-{os.getpid()}") as wire:
        yield wire, partial(python, wire, stdout=subprocess.PIPE)


def test_topics_of_the_other_computer_do_not_cross_to_be_measured(two_computers):
    """The robot's topic is measured; the base computer's, which nobody on the robot reads, stays where it is."""
    wire, start = two_computers
    nodes = [
        start("robot", "-c", NODE, "camera", "/pictures", "/nothing"),
        start("base", "-c", NODE, "planner", "/plans", "/nothing"),
    ]
    assert [node.stdout.readline().strip() for node in nodes] == ["ready", "ready"]
    before = wire.counters()["robot"].rx_bytes
    command = start("robot", "-m", "arpd.cli", "topics", "--seconds", "4", "--json")
    out, _ = command.communicate()
    received = wire.counters()["robot"].rx_bytes - before

    found = {topic["name"]: topic for topic in json.loads(out)["topics"]}
    assert 0 < found["/pictures"]["traffic"]["rate_hz"] < 40  # its source has 20 Hz, less where it has no processor
    assert (found["/pictures"]["writers"], found["/pictures"]["far_writers"]) == (["/camera"], [])
    assert (found["/plans"]["writers"], found["/plans"]["far_writers"]) == ([], ["/planner"])
    assert found["/plans"]["traffic"] is None
    assert found["/nothing"]["readers"] == ["/camera"]
    assert found["/nothing"]["far_readers"] == ["/planner"]
    # Discovery alone; a second of /plans has 400 kB.
    assert received < 200_000
