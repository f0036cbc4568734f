"""The SROS 2 policy in etc/sros2 against the topics and services that arpd's processes open.

The Fast DDS of the wheels was built without security plugins, so these tests compare permissions with open endpoints,
and cannot test the enforcement.
"""

import json
import subprocess
import sys
from contextlib import ExitStack
from fnmatch import fnmatchcase
from xml.etree import ElementTree as ET

import pytest
import rclpy
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.ros.runtime import prepare_environment
from tests.ros.world import DOMAIN, REPO, Ros
from tests.waiting import eventually

POLICY = REPO / "etc/sros2/arpd.policy.xml"
XI = "{http://www.w3.org/2001/XInclude}"
PROCESSES = {"arpd": "/arpd/run", "arpd_relay_robot": "/arpd/relay", "arpd_peer": "/arpd/peer"}  # node → enclave
TOPIC = "/sros2/scan"


def included(path):
    """Parse a policy file, and resolve its includes of whole profiles."""
    root = ET.parse(path).getroot()
    for parent in list(root.iter()):
        for index, child in reversed(list(enumerate(parent))):
            if child.tag == f"{XI}include":
                assert child.get("xpointer") == "xpointer(/profile/*)"
                parent[index : index + 1] = list(included(path.parent / child.get("href")))
    return root


def rules(profile):
    """Return the permissions of a profile as (action, full name) pairs."""
    namespace, node = profile.get("ns", "/").rstrip("/"), profile.get("node", "")

    def full(name):
        return name if name[0] == "/" else f"{namespace}/{node}{name[1:]}" if name[0] == "~" else f"{namespace}/{name}"

    return {
        (what, full(entry.text))
        for group in profile
        for what, answer in group.items()
        for entry in group
        if answer == "ALLOW"
    }


def allowed(name):
    """Return the permissions of the process with this node."""
    (profile,) = (
        profile
        for enclave in included(POLICY).iter("enclave")
        if enclave.get("path") == PROCESSES[name]
        for profile in enclave.iter("profile")
    )
    return rules(profile)


def opened(node, name):
    """Return the endpoints that a node has opened, from the graph."""
    asked = {
        "publish": node.get_publisher_names_and_types_by_node,
        "subscribe": node.get_subscriber_names_and_types_by_node,
        "reply": node.get_service_names_and_types_by_node,
        "request": node.get_client_names_and_types_by_node,
    }
    try:
        return {(what, full) for what, ask in asked.items() for full, _ in ask(name, "/")}
    except rclpy._rclpy_pybind11.NodeNameNonExistentError:
        return set()


def is_used(rule, endpoints):
    return any(what == rule[0] and fnmatchcase(name, rule[1]) for what, name in endpoints)


# On this one host a node in another process counts as across the link.
DAEMON = """
import sys
from arpd.ros.rmw import Rmw
Rmw.tells_hosts = False
from arpd.cli.main import main
main(["run", "--config", sys.argv[1]])
"""


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """Run daemon, relay, peer and a driver with an AdaptivePublisher; return what each opened once it has a plan."""
    config = tmp_path_factory.mktemp("sros2") / "arpd.yaml"
    link = {"interface": "lo", "capacity": "10gbit"}
    config.write_text(json.dumps({"link": link, "http": {"port": 0}, "relay": {"topics": [{"name": TOPIC}]}}))
    argvs = [
        ["-c", DAEMON, config],
        ["-m", "arpd.cli", "relay", "--config", config, "--node-name", "arpd_relay_robot"],
        ["-m", "arpd.cli", "peer", "--interface", "lo"],
    ]
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
        prepare_environment()
        for argv in argvs:
            process = subprocess.Popen([sys.executable, *argv], stderr=subprocess.DEVNULL, cwd=REPO)
            stack.callback(process.wait)
            stack.callback(process.kill)
        node = Ros(stack).node("driver")
        publisher = AdaptivePublisher(node, String, TOPIC, 10)
        node.create_timer(0.05, lambda: publisher.publish(String(data="x")))
        yield wait_for_plan(node)


def wait_for_plan(node):
    """Return the endpoints of every node, once the driver's publisher has a plan and all nodes are there."""

    def is_tuned():
        shared = getattr(node, "_arpd_NodePublishers", None)
        return shared is not None and shared._answer.generation

    def all_opened():
        found = {name: opened(node, name) for name in (*PROCESSES, "driver")}
        is_whole = all(is_used(rule, found[name]) for name in PROCESSES for rule in allowed(name))
        return is_whole and ("reply", "/driver/list_parameters") in found["driver"] and found

    eventually("a plan reaches the driver", is_tuned)
    return eventually("every process has opened all that the policy allows", all_opened)


def test_the_policy_has_sros2s_form():
    """The policy is of sros2's format 0.2.0, and has neither DENY nor a bare *."""
    root = included(POLICY)
    assert (root.tag, root.get("version")) == ("policy", "0.2.0")
    for element in root.iter():
        if element.tag in {"topics", "services"}:
            assert set(element.attrib.values()) == {"ALLOW"}
        if element.tag in {"topic", "service"}:
            assert element.text.strip("/*")


@pytest.mark.parametrize("name", PROCESSES)
def test_an_enclave_allows_exactly_what_its_process_opens(graph, name):
    """Permissions and open endpoints of each process are the same, except for the relay's sources."""
    carried = {("subscribe", TOPIC)} if name.startswith("arpd_relay") else set()
    rules_of_it = allowed(name)
    assert {each for each in graph[name] if not any(is_used(rule, {each}) for rule in rules_of_it)} == carried
