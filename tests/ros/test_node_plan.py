"""A node takes plans from a daemon's messages, whole or not at all, with real rclpy."""

import math

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rclpy.parameter import Parameter
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.adapters.ros.plan_listener import plan_qos
from arpd.adapters.ros.plan_message import crc_of, encode_plan
from arpd.model.plan import TopicPlan
from tests.ros.announced import Announced
from tests.ros.price import TERMS

pytestmark = pytest.mark.ros
A, B = "/a", "/b"
ROW = TopicPlan(rate_hz=50.0, min_rate_hz=1.0, deadline_ns=10**8, depth=40, **TERMS)


@pytest.fixture
def node(ros):
    return ros.node("talker")


@pytest.fixture
def announced(ros):
    return Announced(ros.node("watcher"))


@pytest.fixture
def send(ros):
    publisher = ros.node("daemon").create_publisher(String, "/arpd/plan/talker", plan_qos())

    def send(generation, publishers, lease_s=0.0):
        text = encode_plan(generation=generation, lease_s=lease_s, publishers=publishers)
        publisher.publish(String(data=text))
        return crc_of(text)

    return send


def answers(announced, crc):
    """Return whether the node has answered a message; the answer is then its last one."""
    return "/talker" in announced.answers and announced.answers["/talker"].crc == crc


def test_all_rows_come_into_force_together(node, announced, send, eventually):
    """A plan sets all publishers that are there; a row without a publisher changes nothing."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in (A, B)]
    crc = send(3, {A: ROW, B: ROW, "/gone": ROW}, lease_s=30.0)
    eventually("the node answers", lambda: answers(announced, crc))
    assert announced.answers["/talker"] == (3, crc, "")
    assert [publisher.plan for publisher in publishers] == [ROW, ROW]
    eventually("both depths are in force", lambda: [state.depth for state in announced.states] == [40, 40])
    assert {(state.generation, state.lease_s) for state in announced.states} == {(3, 30.0)}


def test_an_older_plan_is_refused(node, announced, send, eventually):
    """A generation below the one in force changes nothing, and the same one is taken again."""
    publisher = AdaptivePublisher(node, String, A, 10)
    first = send(3, {A: ROW})
    eventually("the node answers", lambda: answers(announced, first))
    crc = send(2, {A: TopicPlan(rate_hz=1.0, min_rate_hz=0.0, deadline_ns=0, depth=7)})
    eventually("the node answers", lambda: answers(announced, crc))
    assert announced.answers["/talker"] == (3, crc, "arpd.generation 2 is older than 3, the plan in force")
    assert publisher.plan == ROW
    assert send(3, {A: ROW}) == first
    eventually("the node answers", lambda: answers(announced, first))


def test_a_node_that_starts_later_finds_its_plan(ros, announced, send, eventually):
    """The plan waits for the node, for its publishers, and for one that the node makes later."""
    crc = send(3, {A: ROW, B: ROW})
    node = ros.node("talker")
    early = AdaptivePublisher(node, String, A, 10)
    eventually("the plan is found", lambda: early.plan == ROW)
    late = AdaptivePublisher(node, String, B, 10)
    assert late.plan == ROW
    assert node.get_parameter("qos_overrides./b.publisher.depth").value == 40
    eventually("the node answers", lambda: answers(announced, crc))


def test_settings_by_hand_last_until_the_next_message(node, announced, send, eventually):
    """What is set by hand is in force and shown, and the plan in force comes back with the next message."""
    publisher = AdaptivePublisher(node, String, A, 10)
    crc = send(3, {A: ROW})
    eventually("the node answers", lambda: answers(announced, crc))
    node.set_parameters([Parameter("arpd./a.publisher.rate", value=5.0)])
    assert publisher.plan.rate_hz == 5.0
    eventually("the rate by hand is announced", lambda: announced.shows(rate_hz=5.0))
    send(3, {A: ROW})
    eventually("the plan is back", lambda: announced.shows(rate_hz=50.0))
    unpaced = TopicPlan(rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=10)
    send(4, {A: unpaced})
    eventually("the next plan is in force", lambda: publisher.plan == unpaced)
