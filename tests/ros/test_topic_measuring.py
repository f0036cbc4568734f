"""`arpd topics` on a live graph: rates and sizes of this host's topics, and nothing that crosses the link for it."""

import json
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Empty, String, UInt8MultiArray

from arpd.adapters.ros import topic_measuring
from arpd.adapters.ros.ends.survey import own_participant
from arpd.adapters.ros.ends.types import UnknownTypeError
from arpd.adapters.ros.link_topics import cannot_tell_hosts, is_confined
from arpd.adapters.ros.rmw import rmw_of
from arpd.adapters.ros.topic_measuring import list_topics
from arpd.model.names import is_internal
from arpd.observe import topic_meter
from tests.ros.conftest import Ros
from tests.ros.domain import DOMAIN
from tests.ros.ends_world import TwoEnds

pytestmark = pytest.mark.ros

REPO = Path(__file__).resolve().parents[2]
BEST_EFFORT = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def process(ros):
    """Make nodes in a participant of their own, as another process has."""

    def process():
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=DOMAIN)
        ros._stack.callback(rclpy.try_shutdown, context=context)
        return Ros(context, ros._stack)

    return process


@pytest.fixture
def survey(ros):
    """List the topics of the other participants."""
    node = rclpy.create_node("survey", context=ros.context)

    def survey(seconds=2.0, prefix="", **options):
        options = {"is_of_interest": lambda topic: not is_internal(topic), **options}
        return {topic.name: topic for topic in list_topics(node, seconds=seconds, prefix=prefix, **options).topics}

    yield survey
    node.destroy_node()


def publish_often(node, msg_type, topic, qos, *, rate_hz, message):
    """Publish on a timer; returns the publisher and the largest number of readers it had."""
    publisher, most = node.create_publisher(msg_type, topic, qos), [0]

    def publish():
        most[0] = max(most[0], publisher.get_subscription_count())
        publisher.publish(message)

    node.create_timer(1.0 / rate_hz, publish)
    return publisher, most


def test_rates_and_sizes_of_all_kinds_of_topics(process, survey):
    """Reliable, best-effort, large, latched, silent and unpublished topics each show what they are."""
    robot = process()
    talker, driver, keeper = robot.node("talker"), robot.node("driver", namespace="/arm"), robot.node("keeper")
    publish_often(talker, String, "/fast", 10, rate_hz=50, message=String(data="x" * 99))
    publish_often(driver, String, "/slow", BEST_EFFORT, rate_hz=4, message=String(data="x" * 9))
    publish_often(
        driver, UInt8MultiArray, "/large", BEST_EFFORT, rate_hz=10, message=UInt8MultiArray(data=[7] * 200_000)
    )
    keeper.create_publisher(String, "/map", LATCHED).publish(String(data="x" * 999))
    keeper.create_publisher(String, "/silent", 10)
    keeper.create_subscription(String, "/cmd", lambda _sample: None, 10)
    keeper.create_subscription(String, "/fast", lambda _sample: None, 10)

    found = survey(seconds=3.0)

    assert {"/fast", "/slow", "/large", "/map", "/silent", "/cmd"} <= found.keys()
    assert found["/fast"].traffic.rate_hz == pytest.approx(50, rel=0.2)
    assert found["/fast"].traffic.mean_bytes == found["/fast"].traffic.largest_bytes == 4 + 4 + 100
    assert (found["/fast"].writers, found["/fast"].readers) == (("/talker",), ("/keeper",))
    assert found["/slow"].traffic.rate_hz == pytest.approx(4, rel=0.2)
    assert found["/slow"].writers == ("/arm/driver",)
    assert found["/large"].traffic.rate_hz == pytest.approx(10, rel=0.3)
    assert 200_000 < found["/large"].traffic.mean_bytes < 200_100
    latched = found["/map"]
    assert (latched.is_latched, latched.traffic.rate_hz, latched.traffic.mean_bytes) == (True, 0.0, 4 + 4 + 1000)
    assert (found["/silent"].traffic.samples, found["/silent"].is_latched) == (0, False)
    assert (found["/cmd"].traffic, found["/cmd"].writers, found["/cmd"].readers) == (None, (), ("/keeper",))
    assert found["/cmd"].unmeasured == "nobody publishes it now"
    assert not any(topic.is_crossing for topic in found.values())


def test_a_topic_of_the_other_side_is_not_brought_over_the_link(process, survey):
    """A topic that another host publishes, alone or with this one, gets no reader."""
    here, beyond = process().node("here"), process().node("beyond")
    readers = [
        publish_often(beyond, String, "/commands", 10, rate_hz=20, message=String())[1],
        publish_often(beyond, String, "/both", 10, rate_hz=20, message=String())[1],
        publish_often(here, String, "/both", 10, rate_hz=20, message=String())[1],
    ]
    publish_often(here, String, "/scan", 10, rate_hz=20, message=String())
    beyond.create_subscription(String, "/scan", lambda _sample: None, 10)
    far = own_participant(beyond)

    found = survey(is_here=lambda participant: participant != far)

    assert readers == [[0], [0], [0]]
    assert (found["/commands"].far_writers, found["/commands"].traffic) == (("/beyond",), None)
    assert "beyond this host" in found["/commands"].unmeasured
    assert (found["/both"].writers, found["/both"].far_writers, found["/both"].traffic) == (
        ("/here",),
        ("/beyond",),
        None,
    )
    assert (found["/scan"].far_readers, found["/scan"].is_crossing) == (("/beyond",), True)
    assert found["/scan"].traffic.rate_hz == pytest.approx(20, rel=0.2)


def test_a_ghost_is_measured_only_where_its_topic_crosses_anyway(process, survey):
    """What arpd's relay writes for a node of the other side crosses once somebody here reads it, and not before."""
    end, reader = process(), process().node("base")
    end.node("arpd_relay_robot")
    planner = end.node("planner")  # a ghost has the original's name
    _, unread = publish_often(planner, String, "/unread", 10, rate_hz=20, message=String())
    publish_often(planner, String, "/cmd_vel", 10, rate_hz=20, message=String())
    reader.create_subscription(String, "/cmd_vel", lambda _sample: None, 10)

    found = survey()

    assert unread == [0]
    assert (found["/unread"].far_writers, found["/unread"].traffic) == (("/planner",), None)
    assert (found["/cmd_vel"].far_writers, found["/cmd_vel"].readers) == (("/planner",), ("/base",))
    assert found["/cmd_vel"].traffic.rate_hz == pytest.approx(20, rel=0.2)
    assert found["/cmd_vel"].is_crossing


def test_both_ends_of_a_real_relay(tmp_path, ros, survey, eventually):
    """With two ends, `arpd topics` shows the other side's nodes, and makes no topic cross that nobody reads."""
    with ExitStack() as stack:
        ends = TwoEnds(tmp_path, stack).start()
        robot, ceddp = ends.side("robot").node("lidar"), ends.side("ceddp").node("planner")
        publish_often(robot, String, "/scan", 10, rate_hz=20, message=String())
        publish_often(ceddp, String, "/cmd_vel", 10, rate_hz=20, message=String())
        _, unread = publish_often(ceddp, String, "/unread", 10, rate_hz=20, message=String())
        ceddp.create_subscription(String, "/scan", lambda _sample: None, 10)
        arrived = []
        robot.create_subscription(String, "/cmd_vel", arrived.append, 10)
        eventually(lambda: len(arrived) > 20, 40.0)

        found = survey()

        assert (found["/scan"].writers, found["/scan"].is_crossing) == (("/lidar",), True)
        assert (found["/cmd_vel"].far_writers, found["/cmd_vel"].readers) == (("/planner",), ("/lidar",))
        assert found["/cmd_vel"].is_crossing
        assert found["/cmd_vel"].traffic.rate_hz == pytest.approx(20, rel=0.3)
        assert (found["/unread"].far_writers, found["/unread"].traffic) == (("/planner",), None)
        assert unread == [0]
        assert not [topic for topic in found if topic.startswith("/arpd")]


def test_a_relayed_topic_is_listed_once(process, survey):
    """A topic and what a relay with one end makes of it are one line, which crosses if somebody beyond reads it."""
    relay, sensor, planner = process().node("arpd_relay_robot"), process().node("lidar"), process().node("planner")
    publish_often(sensor, String, "/scan", 10, rate_hz=10, message=String())
    relay.create_subscription(String, "/scan", lambda _sample: None, 10)
    relay.create_publisher(String, "/link/scan", 10)
    sensor.create_publisher(String, "/link/mine", 10)
    far = own_participant(planner)

    found = survey(prefix="/link", is_here=lambda participant: participant != far)
    assert (found["/scan"].relayed_as, found["/scan"].is_crossing) == ("/link/scan", False)
    assert "/link/scan" not in found
    assert "/link/mine" in found

    planner.create_subscription(String, "/link/scan", lambda _sample: None, 10)
    found = survey(prefix="/link", is_here=lambda participant: participant != far)
    assert (found["/scan"].far_readers, found["/scan"].is_crossing) == (("/planner",), True)


def test_types_that_cannot_be_read_are_listed_with_the_reason(process, survey, monkeypatch):
    """A type that is not installed, and a topic with two types, stay in the list."""

    def message_class(type_name):
        if type_name == "std_msgs/msg/Empty":
            raise UnknownTypeError("std_msgs/msg/Empty is not installed here")
        return String

    monkeypatch.setattr(topic_measuring, "message_class", message_class)
    node = process().node("talker")
    node.create_publisher(Empty, "/odd", 10)
    node.create_publisher(Empty, "/two", 10)
    process().node("listener").create_subscription(String, "/two", lambda _sample: None, 10)

    found = survey(seconds=0.2)

    assert found["/odd"].unmeasured == "std_msgs/msg/Empty is not installed here"
    assert found["/two"].unmeasured == "it has 2 types: std_msgs/msg/Empty, std_msgs/msg/String"
    assert found["/two"].type_name == ""


def test_a_topic_of_which_enough_is_known_is_read_no_more(process, survey, monkeypatch):
    """The reader of a topic goes as soon as its meter has enough, long before the end."""
    monkeypatch.setattr(topic_meter, "ENOUGH_SAMPLES", 20)
    node = process().node("talker")
    publisher, most = publish_often(node, String, "/fast", 10, rate_hz=50, message=String())
    without = []

    def look(elapsed_s, _what):
        if elapsed_s > 2.5:
            without.append(publisher.get_subscription_count())

    found = survey(seconds=4.0, on_progress=look)
    assert most == [1]
    assert without
    assert set(without) == {0}
    assert 20 <= found["/fast"].traffic.samples < 60
    assert found["/fast"].traffic.rate_hz == pytest.approx(50, rel=0.3)


def test_a_node_that_comes_late_is_measured(process, survey):
    """What is published only after the measurement has begun is measured for the rest."""
    node, made = process().node("talker"), []
    node.create_publisher(String, "/early", 10)

    def look(elapsed_s, _what):
        if elapsed_s > 0.5 and not made:
            made.append(publish_often(node, String, "/late", 10, rate_hz=50, message=String()))

    assert survey(seconds=4.0, on_progress=look)["/late"].traffic.rate_hz == pytest.approx(50, rel=0.3)


def test_fast_dds_names_the_host(process, survey, monkeypatch):
    """Where ROS may see other computers, the GUIDs show that a process of this host is one."""
    publish_often(process().node("talker"), String, "/fast", 10, rate_hz=50, message=String())
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert not is_confined()
    assert survey(seconds=1.0)["/fast"].traffic.samples > 0


def test_without_hosts_nothing_is_measured_and_the_reason_is_told(process, ros, monkeypatch):
    """Where no GUID names its host, any topic may come over the link; the list says what helps."""
    monkeypatch.setattr(topic_measuring, "current_rmw", lambda: rmw_of("rmw_other"))
    _, most = publish_often(process().node("talker"), String, "/fast", 10, rate_hz=50, message=String())
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    node = ros.node("survey")
    listed = list_topics(node, seconds=0.5, prefix="", is_of_interest=lambda topic: topic == "/fast")
    assert most == [0]
    assert [(topic.traffic, topic.unmeasured) for topic in listed.topics] == [(None, "its host is unknown")]
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in listed.cannot_tell_hosts
    assert not cannot_tell_hosts(rmw_of("rmw_other"), {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})


def arpd(*arguments, **environment):
    """Run the command in this test's domain."""
    return subprocess.run(
        [sys.executable, "-m", "arpd.cli", *arguments],
        cwd=REPO,
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_the_command_lists_and_suggests_what_check_accepts(process, tmp_path):
    """A user's three commands: look, write a first file, check it."""
    node = process().node("talker")
    publish_often(node, String, "/fast", 10, rate_hz=50, message=String(data="x" * 99))

    document = json.loads(arpd("topics", "--seconds", "1", "--json").stdout)
    (fast,) = [topic for topic in document["topics"] if topic["name"] == "/fast"]
    assert fast["traffic"]["rate_hz"] == pytest.approx(50, rel=0.3)
    assert not [topic for topic in document["topics"] if is_internal(topic["name"])]

    suggested = arpd("topics", "--seconds", "1", "--suggest", "--robot", "10.9.8.7")
    path = tmp_path / "arpd.yaml"
    path.write_text(suggested.stdout)
    assert suggested.returncode == 0
    checked = arpd("check", str(path), "--json", ROS_DOMAIN_ID="0")
    assert checked.returncode == 0
    assert json.loads(checked.stdout)["settings"]["relay.robot"] == "10.9.8.7"
    assert "topics[/fast].weight" in json.loads(checked.stdout)["settings"]


def test_an_empty_domain_says_what_to_check(tmp_path):
    """Without a node there is no empty table, but the variables that hide nodes."""
    found = arpd("topics", "--seconds", "1", ROS_DOMAIN_ID=str(DOMAIN + 50))
    assert (found.returncode, found.stdout) == (1, "")
    for hint in (str(DOMAIN + 50), "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"):
        assert hint in found.stderr
