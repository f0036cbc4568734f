"""The README, followed: what stands between its fences is executed, on a robot and a base computer joined by a link."""

import re
import sys
import textwrap

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.ros.runtime import FASTDDS_PROFILE
from scripts.netns.simlink import INTERFACE
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
# Of the nodes; in the README's link domain live only arpd's processes.
on_the_domain_of_nodes = pytest.mark.parametrize("hosts", [{"domain_id": 21}], indirect=True, ids=[""])
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


def typed(pattern):
    """Return the lines of a shell that a pattern describes, of which there must be one."""
    found = [line for block in FOUND for line in block.commands if re.fullmatch(pattern, line)]
    assert found, f"no line of the documents is {pattern} any more"
    return found


def run(hosts, host, line):
    """Run a line of the README to its end."""
    *told, code = hosts.call(host, "sh", "-c", line)
    assert code == 0, f"{line}: {told}"


def is_planned(hosts, topic):
    """Return whether the plan covers a topic and its publisher confirmed it."""
    rows = hosts.status().get("topics", [])
    return any(row["topic"] == topic and row["planned"] and row["confirmed"] for row in rows)


def use_profile(hosts):
    """Let programs start with the profile that the documents name; it is not installed here, so the checkout's."""
    assert typed(r"export FASTRTPS_DEFAULT_PROFILES_FILE=.*fastdds\.xml.*")
    hosts.environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(FASTDDS_PROFILE)


def users_node(block):
    """Return a program whose node has the lines of a block in its constructor, and publishes on what they make."""
    written = [line for line in textwrap.dedent(block.text).splitlines() if line.strip()]
    imports = [line for line in written if line.startswith(("from ", "import "))]
    body = "\n".join(line for line in written if line not in imports)
    return NODE.format(imports="\n".join(imports), body=textwrap.indent(body, " " * 8))


@on_the_domain_of_nodes
@pytest.mark.parametrize("block", PYTHONS, ids=lambda block: block.section)
def test_ones_own_node_is_found_and_planned(hosts, block):
    """With the README's lines in a node, the installed configuration and a reader over there, topics are planned."""
    use_profile(hosts)
    hosts.start("robot", "run", "arpd", "run", "--config", str(REPO / "etc/arpd/arpd.yaml"))
    hosts.start("base", "peer", "arpd", "peer", "--interface", INTERFACE)
    hosts.start("robot", "node", sys.executable, "-c", users_node(block))
    eventually("the node starts", lambda: "that is all" in hosts.text("node"))
    topics = [line.split() for line in hosts.text("node").splitlines() if line.startswith("/")]
    assert topics, "the block makes no AdaptivePublisher"
    hosts.node("base", "reader", *(f"read:{topic}:sensor_msgs/{kind}" for topic, kind in topics))
    for topic, _ in topics:
        eventually(f"{topic} is planned", lambda topic=topic: is_planned(hosts, topic))
        eventually(f"{topic} arrives", lambda topic=topic: topic in hosts.text("reader"))
    for line in typed(r"arpd [a-z].*"):
        run(hosts, "robot", line)


@on_the_domain_of_nodes
@pytest.mark.parametrize("block", YAMLS, ids=lambda block: block.section)
def test_a_configuration_governs_nodes_that_are_not_ones_own(hosts, block):
    """Each end accepts the README's file; with two ends a plain node's topic crosses by its name, and is planned."""
    use_profile(hosts)
    (hosts.folder / "arpd.yaml").write_text(block.text)
    relay = yaml.safe_load(block.text).get("relay", {})
    for host, key in ((hosts.robot, "robot"), (hosts.base, "base")):
        if key in relay:
            ip(host, "address", "add", f"{relay[key]}/24", "dev", INTERFACE)
    run(hosts, "robot", "arpd check arpd.yaml")
    run(hosts, "base", "arpd check --far arpd.yaml")
    confined = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    hosts.start("robot", "run", "arpd", "run", "--config", "arpd.yaml", **confined)
    eventually("the daemon is ready", lambda: hosts.status().get("ready"))
    if "link_domain" not in relay:
        return
    hosts.start("base", "peer", "arpd", "peer", "--config", "arpd.yaml", **confined)
    hosts.start("robot", "near", "arpd", "relay", "--config", "arpd.yaml", **confined)
    hosts.start("base", "far", "arpd", "relay", "--far", "--config", "arpd.yaml", **confined)
    hosts.node("robot", "lidar", "write:/scan:sensor_msgs/LaserScan", **confined)
    hosts.node("base", "reader", "read:/scan:sensor_msgs/LaserScan", **confined)
    eventually("/scan is planned", lambda: is_planned(hosts, "/scan"))
    eventually("/scan arrives under its own name", lambda: "/scan" in hosts.text("reader"))
    assert hosts.status()["relay"]["to_base"]["wanted"] >= 1
