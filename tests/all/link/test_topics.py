"""`arpd topics` on two computers: what the other one publishes does not cross the link to be measured."""

import json

from tests.all.link.hosts import NEEDS_LINK

pytestmark = NEEDS_LINK


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
