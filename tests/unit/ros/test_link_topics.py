"""Which topics cross the link, and which may be measured, on a graph that a test makes."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.model.endpoints import Direction
from arpd.ros.crossing import read_graph
from arpd.ros.graph import ON_EVERY_NODE, Endpoint
from arpd.ros.names import on_link
from arpd.ros.rmw import Rmw
from arpd.ros.topic_measuring import LinkGraph, cannot_tell_hosts

OWN, ROBOT, RELAY, BEYOND = (bytes([place, 1, host, *[1] * 13]) for place, host in enumerate((1, 1, 1, 2)))
LIDAR, PLANNER, GHOST = Endpoint(gid=ROBOT, node="/lidar"), Endpoint(gid=BEYOND, node="/planner"), Endpoint(gid=RELAY)
MIDDLEWARE = Rmw(name="rmw_fastrtps_cpp")


@pytest.fixture(autouse=True)
def _everywhere(monkeypatch):
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)


def found(topics, *, prefix="", rmw=MIDDLEWARE):
    """Return what is found of topics with these writers and readers, by name, and why each is not measured."""
    view = SimpleNamespace(
        own=Endpoint(gid=OWN),
        types=dict.fromkeys(topics, ("std_msgs/msg/String",)),
        writers=lambda name: [Endpoint(gid=RELAY, node="/arpd_relay")] if name == ON_EVERY_NODE else topics[name][0],
        readers=lambda name: topics[name][1],
        look=lambda: 1,
    )
    graph = LinkGraph(view, rmw)
    assert graph.look()
    listed = {topic.name: topic for topic in graph.topics(prefix=prefix)}
    return listed, {name: graph.obstacle(name) for name in listed}


def test_nothing_is_brought_over_the_link_to_be_measured():
    """Only what this host alone writes gets a reader, and of what arpd's relay writes here what somebody here reads."""
    listed, reasons = found(
        {
            "/commands": ([PLANNER], []),
            "/both": ([PLANNER, LIDAR], []),
            "/scan": ([LIDAR], [PLANNER]),
            "/unwritten": ([], [LIDAR]),
            "/unread": ([GHOST], []),
            "/cmd_vel": ([GHOST], [LIDAR]),
        }
    )
    assert {name for name, reason in reasons.items() if not reason} == {"/scan", "/cmd_vel"}
    assert ("beyond this host" in reasons["/both"], "only to be measured" in reasons["/unread"]) == (True, True)
    assert (listed["/both"].writers, listed["/both"].far_writers) == (("/lidar",), ("/planner",))
    assert listed["/scan"].far_readers == ("/planner",)
    crossing = {name: listed[name].is_crossing for name in ("/scan", "/cmd_vel", "/unread")}
    assert crossing == {"/scan": True, "/cmd_vel": True, "/unread": False}


@pytest.mark.parametrize("far", [[], [PLANNER]], ids=["unread", "read beyond"])
def test_a_relayed_topic_is_listed_once(far):
    """A topic and what a relay with one end makes of it are one line, which crosses if somebody beyond reads it."""
    listed, _ = found(
        {"/scan": ([LIDAR], [GHOST]), "/link/scan": ([GHOST], far), "/link/mine": ([LIDAR], [])}, prefix="/link"
    )
    assert listed.keys() == {"/scan", "/link/mine"}
    assert (listed["/scan"].relayed_as, listed["/scan"].is_crossing) == ("/link/scan", bool(far))


def test_without_hosts_nothing_is_measured_and_the_reason_is_told():
    """Where no GUID names its host, any topic may come over the link; the list says what helps."""
    other = Rmw(name="rmw_other")
    assert all(found({"/fast": ([LIDAR], [])}, rmw=other)[1].values())
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in cannot_tell_hosts(other)
    assert not cannot_tell_hosts(other, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})


def test_the_daemon_knows_a_topic_of_two_ends_by_its_name_on_the_robot():
    """Whatever a stranger reads in the link's domain by that name; and a name that only begins alike is none.

    Logs that cross are known, too, and not what the link's own nodes log.
    """
    end = Endpoint(gid=RELAY, node="/arpd_relay")
    killed = replace(PLANNER, gid=PLANNER.gid[:4] + bytes([99]) + PLANNER.gid[5:])  # and still in the graph
    topics = {on_link("/map"): ([end], [killed, PLANNER]), "/map": ([], [LIDAR]), "/arpd/linked": ([end], [PLANNER])}
    topics |= {on_link("/rosout"): ([end], [PLANNER]), "/parameter_events": ([end], [])}
    view = SimpleNamespace(
        own=Endpoint(gid=OWN, node="/arpd"),
        types=topics,
        writers=lambda name: topics.get(name, ((), ()))[0],
        readers=lambda name: topics.get(name, ((), ()))[1],
    )
    crossings = read_graph(view, MIDDLEWARE).crossings
    later = replace(view.own, gid=OWN[:2] + b"\7" + OWN[3:])  # this process is younger than an address of its host
    view.own = replace(later, node="/arpd")
    assert {each.direction for each in read_graph(view, MIDDLEWARE).crossings.values()} == {Direction.LOCAL}
    assert read_graph(view, MIDDLEWARE, here={end.host}).crossings == crossings
    assert crossings.keys() == {"/map", "/rosout"}
    for crossing in crossings.values():
        assert (crossing.writers, crossing.direction) == ({"/arpd_relay"}, Direction.SENSING)
        assert crossing.remote_readers == 1, "its samples cross once"
