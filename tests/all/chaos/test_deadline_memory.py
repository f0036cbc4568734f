"""Memory that it takes to read how many deadlines a publisher missed."""

import os
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from tests.ros.conftest import _own_network, environment, ros, stack  # noqa: F401 - pytest finds them here

pytestmark = pytest.mark.ros
READS = 20_000


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_reading_the_count_leaks_no_memory(ros):  # noqa: F811 - the fixture
    """Twenty thousand reads of the count take next to no memory."""
    profile = QoSProfile(depth=10, deadline=Duration(nanoseconds=50_000_000))
    publisher = AdaptivePublisher(ros.node("talker"), String, "/silent", profile)
    writer = publisher._flow.swap.current
    before_bytes = resident_bytes()
    for _ in range(READS):
        writer.deadlines_missed()
    assert resident_bytes() - before_bytes < READS * 64
