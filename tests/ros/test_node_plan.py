"""A node takes plans from a daemon's messages, whole or not at all, with real rclpy."""

import json

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.adapters.ros.announcer import Announcer
from arpd.adapters.ros.daemon_messages import plan_qos
from arpd.adapters.ros.plan_message import PlanAnswer, crc_of, encode_plan
from arpd.model.plan import TopicPlan
from arpd.observe.registry import MOST_OF_NODE
from tests.ros.announced import Announced
from tests.ros.price import TERMS
from tests.sample_publishers import publisher as sample

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

    def send(generation, publishers, lease_s=0.0, spoilt=None):
        plan = json.loads(encode_plan(generation=generation, lease_s=lease_s, publishers=publishers))
        plan["publishers"].update(spoilt or {})
        text = json.dumps(plan)
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
    assert announced.answers["/talker"] == (3, crc, "generation 2 is older than 3, the plan in force")
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
    eventually("the node answers", lambda: answers(announced, crc))


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ([0, 0, 1.0, 0.0, 1.0, 9.0, 1], "/a: depth = 0 is outside 1..5000"),
        ([9, -1, 1.0, 0.0, 1.0, 9.0, 1], "/a: deadline_ns = -1 is negative"),
        ([9, 0, 1.0, 0.0, 1e9, 9.0, 1], "/a: weight = 1000000000.0 is outside"),
    ],
)
def test_nonsense_is_refused_with_a_reason(node, announced, send, eventually, row, reason):  # noqa: PLR0917 - fixtures
    """A plan with one bad value changes nothing, and the answer names it."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in (A, B)]
    before = [publisher.plan for publisher in publishers]
    crc = send(3, {A: ROW, B: ROW}, spoilt={A: row})
    eventually("the node answers", lambda: answers(announced, crc))
    assert announced.answers["/talker"].refusal.startswith(reason)
    assert [publisher.plan for publisher in publishers] == before


def test_publishers_beyond_what_a_node_may_announce_are_named(node, capfd):
    """A node with more publishers than a daemon takes says which one is left out, for example."""
    states = [sample("/talker", f"/t{number}") for number in range(MOST_OF_NODE + 2)]
    announcer = Announcer(node, lambda number: states[number])
    announcer.turn(0.0, range(len(states)), answer=PlanAnswer(), lease_s=0.0)
    assert f"manages {MOST_OF_NODE}, and not /t{MOST_OF_NODE}, for example" in capfd.readouterr().err
