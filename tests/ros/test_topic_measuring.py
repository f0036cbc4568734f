"""`arpd topics` on a live graph: what it lists, measures, and does not bring over the link for it."""

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
from std_msgs.msg import String, UInt8MultiArray

from arpd.model.names import is_internal
from arpd.ros.link_topics import is_confined
from arpd.ros.topic_measuring import TopicSurvey
from tests.ros.conftest import Ros
from tests.ros.domain import DOMAIN
from tests.ros.ends_world import TwoEnds

pytestmark = pytest.mark.ros

REPO = Path(__file__).resolve().parents[2]
BEST_EFFORT = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=3, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def robot(ros):
    """Make nodes in a participant of their own, as another process has."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    ros._stack.callback(rclpy.try_shutdown, context=context)
    return Ros(context, ros._stack)


@pytest.fixture
def survey(ros, eventually):
    """List the topics of the other participants, once these are known here."""
    node = rclpy.create_node("survey", context=ros.context)

    def survey(*known):
        eventually(f"{known} are known", lambda: {*known} <= dict(node.get_topic_names_and_types()).keys())
        listed = TopicSurvey(node, prefix="", is_of_interest=lambda topic: not is_internal(topic)).run(2.0)
        return {topic.name: topic for topic in listed.topics}

    yield survey
    node.destroy_node()


def publish_often(node, msg_type, topic, qos, *, rate_hz, message):
    """Publish on a timer; returns the largest number of readers it had."""
    publisher, most = node.create_publisher(msg_type, topic, qos), [0]

    def publish():
        most[0] = max(most[0], publisher.get_subscription_count())
        publisher.publish(message)

    node.create_timer(1.0 / rate_hz, publish)
    return most


def test_all_kinds_of_topics_are_measured(robot, survey, monkeypatch):
    """Reliable, best-effort and latched topics are read, also where only the GUIDs show that they are of this host."""
    talker, driver, keeper = robot.node("talker"), robot.node("driver", namespace="/arm"), robot.node("keeper")
    publish_often(talker, String, "/fast", 10, rate_hz=50, message=String(data="x" * 99))
    large = UInt8MultiArray(data=[7] * 200_000)
    publish_often(driver, UInt8MultiArray, "/large", BEST_EFFORT, rate_hz=10, message=large)
    keeper.create_publisher(String, "/map", LATCHED).publish(String(data="x" * 999))
    keeper.create_subscription(String, "/cmd", lambda _sample: None, 10)
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    assert not is_confined()

    found = survey("/fast", "/large", "/map", "/cmd")

    assert found["/fast"].traffic.mean_bytes == found["/fast"].traffic.largest_bytes == 4 + 4 + 100
    assert found["/fast"].traffic.rate_hz > 0
    assert (found["/large"].writers, found["/large"].type_name) == (("/arm/driver",), "std_msgs/msg/UInt8MultiArray")
    assert 200_000 < found["/large"].traffic.mean_bytes < 200_100
    latched = found["/map"]
    assert (latched.is_latched, latched.traffic.rate_hz, latched.traffic.mean_bytes) == (True, 0.0, 4 + 4 + 1000)
    assert (found["/cmd"].traffic, found["/cmd"].writers, found["/cmd"].readers) == (None, (), ("/keeper",))


def test_both_ends_of_a_real_relay(tmp_path, ros, survey, eventually):
    """With two ends, `arpd topics` shows the other side's nodes, and makes no topic cross that nobody reads."""
    with ExitStack() as stack:
        ends = TwoEnds(tmp_path, stack).start()
        robot, base = ends.side("robot").node("lidar"), ends.side("base").node("planner")
        publish_often(robot, String, "/scan", 10, rate_hz=20, message=String())
        publish_often(base, String, "/cmd_vel", 10, rate_hz=20, message=String())
        unread = publish_often(base, String, "/unread", 10, rate_hz=20, message=String())
        base.create_subscription(String, "/scan", lambda _sample: None, 10)
        arrived = []
        robot.create_subscription(String, "/cmd_vel", arrived.append, 10)
        eventually("the commands arrive", lambda: len(arrived) > 20)

        found = survey("/scan", "/cmd_vel", "/unread")

        assert (found["/scan"].writers, found["/scan"].is_crossing) == (("/lidar",), True)
        assert (found["/cmd_vel"].far_writers, found["/cmd_vel"].readers) == (("/planner",), ("/lidar",))
        assert found["/cmd_vel"].is_crossing
        assert found["/cmd_vel"].traffic.samples > 0
        assert (found["/unread"].far_writers, found["/unread"].traffic) == (("/planner",), None)
        assert unread == [0]
        assert not [topic for topic in found if topic.startswith("/arpd")]


def arpd(*arguments, **environment):
    """Run the command in this test's domain."""
    return subprocess.run(
        [sys.executable, "-m", "arpd.cli", *arguments],
        cwd=REPO,
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_command_lists_and_suggests_what_check_accepts(robot, tmp_path):
    """A user's three commands: look, write a first file, check it."""
    publish_often(robot.node("talker"), String, "/fast", 10, rate_hz=50, message=String(data="x" * 99))

    document = json.loads(arpd("topics", "--seconds", "1", "--json").stdout)
    (fast,) = [topic for topic in document["topics"] if topic["name"] == "/fast"]
    assert fast["traffic"]["rate_hz"] > 0
    assert not [topic for topic in document["topics"] if is_internal(topic["name"])]

    suggested = arpd("topics", "--seconds", "1", "--suggest", "--robot", "10.9.8.7")
    path = tmp_path / "arpd.yaml"
    path.write_text(suggested.stdout)
    assert suggested.returncode == 0
    checked = arpd("check", str(path), "--json", ROS_DOMAIN_ID="0")
    assert checked.returncode == 0
    assert json.loads(checked.stdout)["settings"]["relay.robot"] == "10.9.8.7"
    assert "topics[/fast].weight" in json.loads(checked.stdout)["settings"]


def test_an_empty_domain_says_what_to_check():
    """Without a node there is no empty table, but the variables that hide nodes."""
    found = arpd("topics", "--seconds", "1", ROS_DOMAIN_ID=str(DOMAIN + 50))
    assert (found.returncode, found.stdout) == (1, "")
    for hint in (str(DOMAIN + 50), "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"):
        assert hint in found.stderr
