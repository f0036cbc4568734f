"""`arpd doctor` on both ends of a real link, with a daemon, a peer and nodes."""

from __future__ import annotations

import json
import subprocess
import time

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.runtime import PROFILE_VARIABLES
from scripts.netns.simlink import INTERFACE, SimLink
from tests.all.link.hosts import NEEDS_LINK, ip, python
from tests.waiting import eventually

pytestmark = NEEDS_LINK
NODE = """
import threading, time
import rclpy
from std_msgs.msg import String
from arpd import AdaptivePublisher
rclpy.init()
node = rclpy.create_node("camera")
publisher = AdaptivePublisher(node, String, "/image", 10)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
while True:
    publisher.publish(String(data="x" * 500))
    time.sleep(0.1)
"""


class Ends:
    """Both ends of the link: processes of arpd's on them, and what the doctor says there."""

    def __init__(self, link, folder):
        self.link = link
        self._folder = folder
        self.config = folder / "arpd.yaml"
        self.config.write_text("http: {host: 10.77.0.1}\n")

    def start(self, host, name, *argv, environment=()):
        with (self._folder / f"{name}.log").open("w") as log:
            self._python(host, *argv, environment=environment, stdout=log, stderr=log)

    def _python(self, host, *argv, environment=(), **options):
        set_here = [*(f"--unset={name}" for name in PROFILE_VARIABLES), *environment]
        return python(self.link, host, *argv, environment=set_here, cwd=self._folder, **options)

    def doctor(self, host, *options):
        """Return the checks by name, each with its health and text."""
        command = ("-m", "arpd.cli", "doctor", "--json", "--config", str(self.config), *options)
        asked = self._python(host, *command, stdout=subprocess.PIPE)
        told = json.loads(asked.communicate()[0])
        assert asked.returncode == (0 if told["ok"] else 1)
        assert told["interface"] == INTERFACE
        return {check["check"]: (check["health"], check["text"]) for check in told["checks"]}


@pytest.fixture
def ends(tmp_path):
    with SimLink(f"doctor-{time.monotonic_ns() % 10**9}") as link:
        yield Ends(link, tmp_path)


def test_both_ends_are_looked_at(ends):
    """One clock is one; the node without the profile is found, and only it; a small MTU is wrong where it is."""
    ends.start("robot", "run", "-m", "arpd.cli", "run", "--config", str(ends.config))
    ends.start("base", "peer", "-m", "arpd.cli", "peer")
    ends.start("robot", "node", "-c", NODE)
    found = {}

    def knows():
        found.update(ends.doctor("robot", "--listen", "0"))
        return found["clock"][0] == "fine" and found["profile"][0] == "wrong"

    eventually("the doctor knows the clocks and the node without a profile", knows)
    assert "/camera" in found["profile"][1]
    assert (found["mtu"][0], found["discovery"][0], found["versions"][0]) == ("fine", "unknown", "fine")
    ip(ends.link.base, "link", "set", INTERFACE, "mtu", "1300")
    far = ends.doctor("base", "--url", "http://10.77.0.1:9464")
    assert (far["clock"][0], far["mtu"][0], far["versions"][0]) == ("fine", "wrong", "fine")
    assert "at both ends" in far["versions"][1]
    assert "1 of this computer" not in far["discovery"][1]  # the peer is arpd's own

    def is_the_node_alone():  # the daemon is arpd's own, and the peer may be
        health, text = ends.doctor("robot")["discovery"]
        return health == "fine" and "1 participant" in text

    eventually("the node's participant is found on the robot", is_the_node_alone)


def test_with_two_ends_a_node_that_announces_itself_is_found(ends):
    """The relay carries its topics, so nothing but arpd belongs on the link."""
    ends.config.write_text("relay: {link_domain: 103, robot: 10.77.0.1, base: 10.77.0.2}\n")
    assert ends.doctor("robot", "--listen", "1")["discovery"][0] == "fine"
    ends.start("robot", "node", "-c", NODE)
    eventually("the node is found", lambda: ends.doctor("robot", "--listen", "4")["discovery"][0] == "wrong")


def test_a_node_over_tcp_that_arpd_cannot_hear_is_found(ends):
    """A node with LARGE_DATA and a daemon without it never meet."""
    ends.start("robot", "run", "-m", "arpd.cli", "run", "--config", str(ends.config))
    ends.start("robot", "node", "-c", NODE, environment=["FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"])

    def judged():
        health, text = ends.doctor("robot", "--listen", "4")["transports"]
        return health == "wrong" and "TCPv4 there, UDPv4 here" in text

    eventually("the doctor knows that they never meet", judged)
