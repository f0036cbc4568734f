"""What may cross a real link: with two ends nothing but arpd's, and no topic only to be measured."""

import json
import re

from tests.all.link.hosts import NEEDS_LINK, second_network
from tests.waiting import eventually

pytestmark = NEEDS_LINK
REFUSED = "/cries does not cross as it should: /crier of the other side is visible in this domain without the relay"


CONFINED = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def two_ends(hosts):
    (hosts.folder / "arpd.yaml").write_text("relay: {link_domain: 102, robot: 10.77.0.1, base: 10.77.0.2}\n")
    hosts.start("robot", "near", "arpd", "relay", "--config", "arpd.yaml", **CONFINED)
    hosts.start("base", "far", "arpd", "relay", "--config", "arpd.yaml", "--far", **CONFINED)


def nft(hosts, host, rules):
    _, error, code = hosts.call(host, "nft", rules)
    assert code == 0, error


def test_a_node_that_announces_itself_on_the_link_is_named(hosts):
    """A node of the robot that announces itself on the link is refused by name; a confined one is not."""
    two_ends(hosts)
    hosts.node("robot", "whisperer", "write:/whispers:std_msgs/String", **CONFINED)
    for end in ("near", "far"):
        eventually("both ends meet", lambda end=end: "the other end is" in hosts.text(end))
    hosts.node("robot", "crier", "write:/cries:std_msgs/String")
    eventually("the node on the link is named", lambda: REFUSED in hosts.text("near") + hosts.text("far"))
    assert "/whispers" not in hosts.text("near") + hosts.text("far")


def test_samples_cross_once_where_the_other_computer_has_a_second_network(hosts):
    """It tells the ends' address alone, so the default route leads nothing there."""
    second_network(hosts.base, hosts.robot)
    two_ends(hosts)
    hosts.node("robot", "camera", "write:/pictures:std_msgs/String:20000", **CONFINED)
    hosts.node("base", "planner", "read:/pictures:std_msgs/String", **CONFINED)

    def seen():
        return hosts.text("planner").count("/pictures")

    eventually("the topic crosses", lambda: seen() > 20)
    before, sent_bytes = seen(), hosts.link.counters()["robot"].tx_bytes
    eventually("more has crossed", lambda: seen() >= before + 60)
    sent_bytes = hosts.link.counters()["robot"].tx_bytes - sent_bytes
    assert sent_bytes / (seen() - before) < 1.5 * 20_000


def test_a_daemon_that_is_younger_than_an_address_knows_its_relay(hosts):
    """Docker or a VPN may come up between the start of the relay and a restart of the daemon."""
    two_ends(hosts)
    hosts.node("robot", "camera", "write:/pictures:std_msgs/String:20000", **CONFINED)
    hosts.node("base", "planner", "read:/pictures:std_msgs/String", **CONFINED)
    eventually("the topic crosses", lambda: hosts.text("planner").count("/pictures") > 20)
    second_network(hosts.robot, hosts.base)
    hosts.start("robot", "daemon", "arpd", "run", "--config", "arpd.yaml", **CONFINED)
    eventually("it is planned", lambda: [each["topic"] for each in hosts.status().get("topics", ())] == ["/pictures"])
    eventually("its plan is in force", lambda: hosts.status()["topics"][0]["confirmed"]["generation"] > 0)


def test_a_firewall_must_let_in_the_ports_that_the_status_names(hosts):
    """With them open, and nothing else but loopback, topics cross."""
    for host in hosts.link.hosts:
        nft(hosts, host, "table inet f { chain i { type filter hook input priority 0; policy drop; iif lo accept; }; }")
    two_ends(hosts)
    hosts.start("robot", "run", "arpd", "run", "--config", "arpd.yaml", **CONFINED)

    def named():
        return re.search(r"let UDP ports (\d+) to (\d+) in, on both", str(hosts.status()))

    first, last = eventually("the status names ports", named).groups()
    for host in hosts.link.hosts:
        nft(hosts, host, f"add rule inet f i udp dport {first}-{last} accept")
    hosts.node("robot", "camera", "write:/pictures:std_msgs/String", **CONFINED)
    hosts.node("base", "planner", "read:/pictures:std_msgs/String", **CONFINED)
    eventually("the topic crosses", lambda: "/pictures" in hosts.text("planner"))


def test_pictures_go_on_where_no_datagram_of_several_packets_arrives_any_more(hosts):
    """The robot's end says so, and sends packets; DDS itself meets nobody in such a network."""
    two_ends(hosts)
    hosts.start("robot", "run", "arpd", "run", "--config", "arpd.yaml", **CONFINED)
    hosts.start("base", "peer", "arpd", "peer", "--config", "arpd.yaml", **CONFINED)
    hosts.node("robot", "camera", "write:/pictures:std_msgs/String:60000", **CONFINED)
    hosts.node("base", "planner", "read:/pictures:std_msgs/String", **CONFINED)

    def go_on():
        before = hosts.text("planner").count("/pictures")
        eventually("pictures cross", lambda: hosts.text("planner").count("/pictures") > before + 20)

    eventually("the link is known to be clean", lambda: hosts.metric("arpd_link_loss_ratio") == 0.0)
    go_on()
    drop = "table ip f { chain p { type filter hook prerouting priority -450; ip frag-off & 0x3fff != 0 drop; }; }"
    nft(hosts, hosts.base, drop)
    eventually("the loss is said", lambda: "the link loses datagrams" in hosts.text("near"))
    go_on()


def test_topics_of_the_other_computer_do_not_cross_to_be_measured(hosts):
    """The robot's topic is measured; the base computer's, which nobody on the robot reads, stays where it is."""
    for host, name, topic in (("robot", "camera", "/pictures"), ("base", "planner", "/plans")):
        hosts.node(host, name, f"write:{topic}:std_msgs/String:20000", "read:/nothing:std_msgs/String")
    before = hosts.link.counters()["robot"].rx_bytes
    out, _, _ = hosts.call("robot", "arpd", "topics", "--seconds", "4", "--json")
    received = hosts.link.counters()["robot"].rx_bytes - before

    found = {topic["name"]: topic for topic in json.loads(out)["topics"]}
    assert 0 < found["/pictures"]["traffic"]["rate_hz"] < 40  # its source has 20 Hz, less where it has no processor
    assert (found["/pictures"]["writers"], found["/pictures"]["far_writers"]) == (["/camera"], [])
    assert (found["/plans"]["writers"], found["/plans"]["far_writers"]) == ([], ["/planner"])
    assert found["/plans"]["traffic"] is None
    assert found["/nothing"]["readers"] == ["/camera"]
    assert found["/nothing"]["far_readers"] == ["/planner"]
    # Discovery alone; a second of /plans has 400 kB.
    assert received < 200_000
