"""Two ends over a real link: nothing but arpd may be on it."""

from tests.all.link.hosts import NEEDS_LINK
from tests.waiting import eventually

pytestmark = NEEDS_LINK
REFUSED = "/cries does not cross as it should: /crier of the other side is visible in this domain without the relay"


def test_a_node_that_announces_itself_on_the_link_is_named(hosts):
    """A node of the robot that announces itself on the link is refused by name; a confined one is not."""
    (hosts.folder / "arpd.yaml").write_text("relay: {link_domain: 102, robot: 10.77.0.1, base: 10.77.0.2}\n")
    confined = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    hosts.start("robot", "near", "arpd", "relay", "--config", "arpd.yaml", **confined)
    hosts.start("base", "far", "arpd", "relay", "--config", "arpd.yaml", "--far", **confined)
    hosts.node("robot", "whisperer", "write:/whispers:std_msgs/String", **confined)
    for end in ("near", "far"):
        eventually("both ends meet", lambda end=end: "the other end is" in hosts.text(end))
    hosts.node("robot", "crier", "write:/cries:std_msgs/String")
    eventually("the node on the link is named", lambda: REFUSED in hosts.text("near") + hosts.text("far"))
    assert "/whispers" not in hosts.text("near") + hosts.text("far")
