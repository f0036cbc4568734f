"""`arpd doctor` on both ends of a real link, with a daemon, a peer and nodes."""

import json
import sys

import pytest

from arpd.ros.runtime import FASTDDS_PROFILE
from scripts.netns.simlink import INTERFACE
from tests.all.link.hosts import NEEDS_LINK, NODE, ip, second_network
from tests.waiting import eventually

pytestmark = NEEDS_LINK
CAMERA = ("robot", "camera", "adapt:/image:std_msgs/String:500")


def run(hosts):
    (hosts.folder / "arpd.yaml").write_text("http: {host: 10.77.0.1}\n")
    hosts.start("robot", "run", "arpd", "run", "--config", "arpd.yaml")


def doctor(hosts, host, *options):
    """Return the checks by name, each with its health and text."""
    told, _, code = hosts.call(host, "arpd", "doctor", "--json", "--config", "arpd.yaml", *options)
    told = json.loads(told)
    assert code == (0 if told["ok"] else 1)
    assert told["interface"] == INTERFACE
    return {check["check"]: (check["health"], check["text"]) for check in told["checks"]}


def test_both_ends_are_looked_at(hosts):
    """One clock is one; the node without the profile is found, and only it; a small MTU is wrong where it is."""
    run(hosts)
    hosts.start("base", "peer", "arpd", "peer")
    hosts.node(*CAMERA)
    found = {}

    def knows():
        found.update(doctor(hosts, "robot", "--listen", "0"))
        return found["clock"][0] == "fine" and found["profile"][0] == "wrong"

    eventually("the doctor knows the clocks and the node without a profile", knows)
    assert "/camera" in found["profile"][1]
    assert (found["mtu"][0], found["discovery"][0], found["versions"][0]) == ("fine", "unknown", "fine")
    ip(hosts.base, "link", "set", INTERFACE, "mtu", "1300")
    far = doctor(hosts, "base", "--url", "http://10.77.0.1:9464")
    assert (far["clock"][0], far["mtu"][0], far["versions"][0]) == ("fine", "wrong", "fine")
    assert "at both ends" in far["versions"][1]
    assert "1 of this computer" not in far["discovery"][1]  # the peer is arpd's own

    def is_the_node_alone():  # here; the daemon is arpd's own
        health, text = doctor(hosts, "robot")["discovery"]
        return health == "fine" and "1 of this computer (node.py)" in text

    eventually("the node's participant is found on the robot", is_the_node_alone)


def test_a_second_network_of_the_other_computer_is_found(hosts):
    """The link leads there, too, so its nodes get every sample twice."""
    second_network(hosts.base, hosts.robot)
    (hosts.folder / "arpd.yaml").touch()
    hosts.node("base", "planner", "read:/image:std_msgs/String")

    def judged():
        health, text = doctor(hosts, "robot", "--listen", "4")["discovery"]
        return health == "wrong" and "10.77.0.2 and 172.17.0.1" in text

    eventually("the doctor names both addresses", judged)


def test_with_two_ends_a_node_that_announces_itself_is_found(hosts):
    """The relay carries its topics, so nothing but arpd belongs on the link."""
    (hosts.folder / "arpd.yaml").write_text("relay: {link_domain: 103, robot: 10.77.0.1, base: 10.77.0.2}\n")
    assert doctor(hosts, "robot", "--listen", "1")["discovery"][0] == "fine"
    hosts.node(*CAMERA)
    eventually("the node is found", lambda: doctor(hosts, "robot", "--listen", "4")["discovery"][0] == "wrong")


def test_a_node_over_tcp_that_arpd_cannot_hear_is_found(hosts):
    """A node with LARGE_DATA and a daemon without it never meet."""
    run(hosts)
    hosts.node(*CAMERA, FASTDDS_BUILTIN_TRANSPORTS="LARGE_DATA")

    def judged():
        health, text = doctor(hosts, "robot", "--listen", "4")["transports"]
        return health == "wrong" and "TCPv4 there, UDPv4 here" in text

    eventually("the doctor knows that they never meet", judged)


@pytest.mark.parametrize("hosts", [{"memory": True}], indirect=True)
def test_with_large_data_everywhere_all_publishers_are_managed_and_one_without_shared_memory_is_named(hosts):
    """Three publishers of three processes get a new QoS; the doctor finds a container that has not arpd's memory."""
    everywhere = {"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}
    hosts.environment |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE)}
    topics = {f"/{name}" for name in "abc"}
    (hosts.folder / "arpd.yaml").write_text("http: {host: 10.77.0.1}\n")
    hosts.start("robot", "run", "arpd", "run", "--config", "arpd.yaml", **everywhere)
    hosts.start("base", "peer", "arpd", "peer", **everywhere)
    for topic in topics:
        hosts.node("robot", f"talker_{topic[1:]}", f"adapt:{topic}:std_msgs/String:500", **everywhere)
    hosts.node("base", "reader", *(f"read:{topic}:std_msgs/String" for topic in topics), **everywhere)

    def swapped():
        found = hosts.call("robot", "arpd", "status", "--json", "--url", "http://10.77.0.1:9464")[0]
        told = json.loads(found)["topics"] if found else []
        return {topic["topic"] for topic in told if topic["confirmed"]["swaps_by_result"].get("ok")} == topics

    eventually("all three are swapped", swapped)
    eventually("their samples arrive", lambda: all(f"{topic} 000000" in hosts.text("reader") for topic in topics))
    own_memory = ("unshare", "-m", "sh", "-c", 'mount -t tmpfs tmpfs /dev/shm && exec "$@"', "sh")
    hosts.start("robot", "hermit", *own_memory, sys.executable, str(NODE), "hermit", *CAMERA[2:], **everywhere)

    def judged():
        health, text = doctor(hosts, "robot", "--listen", "4")["transports"]
        return health == "wrong" and "node.py and arpd find each other and exchange nothing" in text

    eventually("the doctor names it", judged)
