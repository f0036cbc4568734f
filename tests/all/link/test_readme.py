"""The README, followed: what stands between its fences is executed, on a robot and a base computer joined by a link."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import textwrap
import urllib.request

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.runtime import FASTDDS_PROFILE
from scripts.netns.namespaces import inside
from scripts.netns.simlink import INTERFACE, SimLink
from tests.all.link.hosts import NEEDS_LINK, REPO, ip
from tests.readme_blocks import blocks
from tests.waiting import eventually

pytestmark = NEEDS_LINK
# What a user follows from an empty computer to topics that arpd manages.
FOUND = [
    block
    for name, section in (
        ("README.md", "Install"),
        ("README.md", "Configure"),
        ("docs/operating.md", "The Fast DDS profile"),
    )
    for block in blocks(name)
    if block.section == section
]
PYTHONS, YAMLS = ([block for block in FOUND if block.language == language] for language in ("python", "yaml"))
DOMAIN = 21  # of the nodes; in the README's link domain live only arpd's processes
PORT = 9464
NODE = """
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import *
{imports}

class UsersNode(Node):
    def __init__(self):
        super().__init__("users_node")
{body}

rclpy.init()
node = UsersNode()
mine = [one for one in vars(node).values() if isinstance(one, AdaptivePublisher)]
for publisher in mine:
    node.create_timer(0.05, lambda publisher=publisher: publisher.publish(publisher.msg_type()))
    print(publisher.topic_name, publisher.msg_type.__name__, flush=True)
print("that is all", flush=True)
rclpy.spin(node)
"""
PLAIN = """
import sys, rclpy
from rclpy.node import Node
from sensor_msgs import msg
kind = getattr(msg, sys.argv[3])
rclpy.init()
node = Node(sys.argv[1])
if sys.argv[1] == "reader":
    node.create_subscription(kind, sys.argv[2], lambda _: print("received", flush=True), 10)
else:
    publisher = node.create_publisher(kind, sys.argv[2], 10)
    node.create_timer(0.05, lambda: publisher.publish(kind()))
rclpy.spin(node)
"""


def typed(pattern):
    """Return the lines of a shell that a pattern describes, of which there must be one."""
    found = [line for block in FOUND for line in block.commands if re.fullmatch(pattern, line)]
    assert found, f"no line of the documents is {pattern} any more"
    return found


class World:
    """A link whose hosts run what a user starts there."""

    def __init__(self, link, folder):
        self.link, self.folder = link, folder
        # Nodes start with the profile that the documents name; it is not installed here, so it comes from the checkout.
        self._environment = {**os.environ, "PYTHONPATH": str(REPO), "PATH": f"{folder}:{os.environ['PATH']}"}
        assert typed(r"export FASTRTPS_DEFAULT_PROFILES_FILE=.*fastdds\.xml.*")
        self._environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(FASTDDS_PROFILE)
        command = folder / "arpd"
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -m arpd.cli "$@"\n')
        command.chmod(0o755)

    def start(self, host, name, *argv, reach="SUBNET"):
        """Start a process; ``text`` returns what it printed."""
        with (self.folder / f"{name}.log").open("w") as log:
            self.link.popen(
                host,
                ["env", f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}", *argv],
                env=self._environment,
                cwd=self.folder,
                stdout=log,
                stderr=log,
            )

    def python(self, host, name, script, *argv, reach="SUBNET"):
        (self.folder / f"{name}.py").write_text(script)
        self.start(host, name, sys.executable, "-u", str(self.folder / f"{name}.py"), *argv, reach=reach)

    def text(self, name):
        return (self.folder / f"{name}.log").read_text()

    def run(self, host, line):
        """Run a line of the README to its end."""
        process = self.link.popen(
            host,
            ["sh", "-c", line],
            env=self._environment,
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        said, _ = process.communicate()
        assert process.returncode == 0, f"{line}: {said}"

    def address(self, host, address):
        """Give a host's end of the link one more address."""
        ip(host, "address", "add", f"{address}/24", "dev", INTERFACE)

    def status(self):
        """Return what the daemon says, empty while it does not answer."""

        def ask():
            with urllib.request.urlopen(f"http://127.0.0.1:{PORT}/api/v1/status", timeout=5) as answer:
                return json.load(answer)

        try:
            return inside(self.link.robot.namespace, ask)
        except OSError:
            return {}

    def is_planned(self, topic):
        """Return whether the plan covers a topic and its publisher confirmed it."""
        rows = self.status().get("topics", [])
        return any(row["topic"] == topic and row["planned"] and row["confirmed"] for row in rows)

    def told(self):
        """Return every log, for a failure."""
        return "\n".join(f"--- {log.name}\n{log.read_text()[-2000:]}" for log in sorted(self.folder.glob("*.log")))


@pytest.fixture
def world(tmp_path):
    with SimLink(f"readme-{os.getpid()}", domain_id=DOMAIN) as link:
        world = World(link, tmp_path)
        try:
            yield world
        finally:
            print(world.told())


def users_node(block):
    """Return a program whose node has the lines of a block in its constructor, and publishes on what they make."""
    written = [line for line in textwrap.dedent(block.text).splitlines() if line.strip()]
    imports = [line for line in written if line.startswith(("from ", "import "))]
    body = "\n".join(line for line in written if line not in imports)
    return NODE.format(imports="\n".join(imports), body=textwrap.indent(body, " " * 8))


@pytest.mark.parametrize("block", PYTHONS, ids=lambda block: block.section)
def test_ones_own_node_is_found_and_planned(world, block):
    """With the README's lines in a node, the installed configuration and a reader over there, topics are planned."""
    world.start("robot", "run", "arpd", "run", "--config", str(REPO / "etc/arpd/arpd.yaml"))
    world.start("base", "peer", "arpd", "peer", "--interface", INTERFACE)
    world.python("robot", "node", users_node(block))
    eventually("the node starts", lambda: "that is all" in world.text("node"))
    topics = [line.split() for line in world.text("node").splitlines() if line.startswith("/")]
    assert topics, "the block makes no AdaptivePublisher"
    for number, (topic, kind) in enumerate(topics):
        world.python("base", f"reader{number}", PLAIN, "reader", topic, kind)
    for number, (topic, _) in enumerate(topics):
        eventually(f"{topic} is planned", lambda topic=topic: world.is_planned(topic))
        eventually(f"{topic} arrives", lambda number=number: "received" in world.text(f"reader{number}"))
    for line in typed(r"arpd [a-z].*"):
        world.run("robot", line)


@pytest.mark.parametrize("block", YAMLS, ids=lambda block: block.section)
def test_a_configuration_governs_nodes_that_are_not_ones_own(world, block):
    """Each end accepts the README's file; with two ends a plain node's topic crosses by its name, and is planned."""
    config = world.folder / "arpd.yaml"
    config.write_text(block.text)
    relay = yaml.safe_load(block.text).get("relay", {})
    for host, key in ((world.link.robot, "robot"), (world.link.base, "base")):
        if key in relay:
            world.address(host, relay[key])
    world.run("robot", "arpd check arpd.yaml")
    world.run("base", "arpd check --far arpd.yaml")
    world.start("robot", "run", "arpd", "run", "--config", str(config), reach="LOCALHOST")
    eventually("the daemon is ready", lambda: world.status().get("ready"))
    if "link_domain" not in relay:
        return
    world.start("base", "peer", "arpd", "peer", "--config", str(config), reach="LOCALHOST")
    world.start("robot", "near", "arpd", "relay", "--config", str(config), reach="LOCALHOST")
    world.start("base", "far", "arpd", "relay", "--far", "--config", str(config), reach="LOCALHOST")
    world.python("robot", "lidar", PLAIN, "lidar", "/scan", "LaserScan", reach="LOCALHOST")
    world.python("base", "reader", PLAIN, "reader", "/scan", "LaserScan", reach="LOCALHOST")
    eventually("/scan is planned", lambda: world.is_planned("/scan"))
    eventually("/scan arrives under its own name", lambda: "received" in world.text("reader"))
    assert world.status()["relay"]["to_base"]["wanted"] >= 1
