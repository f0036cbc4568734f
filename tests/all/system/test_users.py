"""The units of a relay with two ends, and nodes of another user than theirs on both computers."""

import json
import re
from pathlib import Path

import pytest

from tests.all.system.computers import CONFIG, SYSTEM_PYTHON, as_user
from tests.waiting import eventually

pytestmark = [pytest.mark.link, pytest.mark.ros, pytest.mark.timeout(900)]  # the first one builds a package

NODE = "/srv/node.py"
OF_ROBOT = ("/odometry:std_msgs/String", "/camera:std_msgs/String:200000")
OF_BASE = ("/command:std_msgs/String", "/map:std_msgs/String:200000")


@pytest.fixture(scope="module")
def ends(computers):
    """Start what README names for two ends, and a node on each computer that stays on it."""
    link = ", ".join(f"{host.name}: {host.address}" for host in computers.link.hosts)
    sides = (
        (computers.robot, ("arpd", "arpd-relay"), OF_ROBOT, OF_BASE),
        (computers.base, ("arpd-peer", "arpd-relay-far"), OF_BASE, OF_ROBOT),
    )
    for host, units, written, read in sides:
        computers.install("first", host)
        host.write(CONFIG, f"relay: {{link_domain: 77, {link}}}\n")
        host.write(NODE, Path(__file__).parents[1].joinpath("node.py").read_text())
        started = host.call("systemctl", "restart", *units)
        assert started.returncode == 0, started.stderr + "".join(map(host.journal, units))
        parts = (*(f"write:{topic}" for topic in written), *(f"read:{topic}" for topic in read))
        node = as_user("env", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST", SYSTEM_PYTHON, "-u", NODE, "user", *parts)
        started = host.call("systemd-run", "--unit=nodes", *node)
        assert started.returncode == 0, started.stderr
    yield computers
    for host, *_ in sides:
        host.call("systemctl", "stop", "nodes")


def test_topics_of_another_users_nodes_cross_both_ways(ends):
    """Small and large samples reach the other side; nodes would share memory, which no other user can read."""
    for host, topics in ((ends.base, ("/odometry", "/camera")), (ends.robot, ("/command", "/map"))):
        for topic in topics:
            eventually(f"{topic} crosses", lambda host=host, topic=topic: heard(host, topic) >= 10)


@pytest.mark.parametrize("discovery", ["SUBNET", "LOCALHOST"])
def test_root_measures_topics_of_another_users_nodes(ends, discovery):
    """`arpd topics` has the rates of a robot's nodes, whichever range root's shell has."""
    measure = ". /opt/ros/jazzy/setup.bash; /usr/local/bin/arpd topics --json --seconds 2"
    shell = ("env", "-i", "HOME=/root", f"ROS_AUTOMATIC_DISCOVERY_RANGE={discovery}", "bash", "-c")
    told = ends.robot.call(*shell, measure)
    assert told.returncode == 0, told.stderr
    rates = {topic["name"]: topic["traffic"]["rate_hz"] for topic in json.loads(told.stdout)["topics"]}
    assert rates["/odometry"] > 0
    assert rates["/camera"] > 0


def heard(host, topic):
    """Return how many samples of a topic the computer's node has said that it has read."""
    return len(re.findall(rf": {topic} \d{{8}}$", host.journal("nodes"), re.MULTILINE))
