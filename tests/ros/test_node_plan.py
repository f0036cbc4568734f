"""A node takes plans from a daemon's messages, whole or not at all, with real rclpy."""

import gc
import math
from dataclasses import replace
from itertools import count

import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from arpd import AdaptivePublisher
from arpd.endpoint import node_publishers
from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.plan import PlanAnswer, TopicPlan
from arpd.model.relay import RelaySummary
from tests.ros.world import TERMS, Announced, Plans

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
    return Plans(ros.node("daemon"))


@pytest.fixture
def answers(announced, eventually):
    """Wait until the node has answered so."""

    def wait(*answer):
        eventually("the node answers", lambda: announced.answers.get("/talker") == PlanAnswer(*answer))

    return wait


def test_all_rows_come_into_force_together_and_an_older_plan_is_refused(node, announced, send, answers, eventually):
    """A plan sets all publishers that are there, and changes nothing else; one from before the one in force nothing."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in (A, B)]
    send(3, {A: ROW, B: ROW, "/gone": ROW}, lease_s=30.0)
    answers(3, 30.0)
    assert [publisher.plan for publisher in publishers] == [ROW, ROW]
    eventually("both depths are in force", lambda: [state.depth for state in announced.states] == [40, 40])
    assert {(state.generation, state.lease_s) for state in announced.states} == {(3, 30.0)}
    send(2, {A: TopicPlan(rate_hz=1.0, min_rate_hz=0.0, deadline_ns=0, depth=7)})
    answers(3, 30.0, 2, "generation 2 is older than 3, the plan in force")
    assert [publisher.plan for publisher in publishers] == [ROW, ROW]
    send(3, {A: ROW})
    answers(3)


def test_a_node_that_starts_later_finds_its_plan(ros, send, answers, eventually):
    """The plan waits for the node, for its publishers, and for one that the node makes later."""
    send(3, {A: ROW, B: ROW})
    node = ros.node("talker")
    early = AdaptivePublisher(node, String, A, 10)
    eventually("the plan is found", lambda: early.plan == ROW)
    late = AdaptivePublisher(node, String, B, 10)
    assert late.plan == ROW
    answers(3)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ([-1, 0, 1.0, 0.0, 1.0, 9.0, 1, 0.0], "/a: depth = '-1' is not an integer from 1 to 5000"),
        ([9, 0, 1.0], "/a: '[9, 0, 1.0]' has not the numbers depth, deadline_ns,"),
    ],
)
def test_nonsense_is_refused_with_a_reason(node, announced, send, eventually, row, reason):  # noqa: PLR0917 - fixtures
    """A plan with one bad value changes nothing, and the answer names it."""
    publishers = [AdaptivePublisher(node, String, topic, 10) for topic in (A, B)]
    before = [publisher.plan for publisher in publishers]
    send(3, {A: ROW, B: ROW}, spoilt={A: row})
    answer = eventually(
        "the node refuses it", lambda: (found := announced.answers.get("/talker")) and found.refusal and found
    )
    assert (answer.generation, answer.refused, answer.refusal[: len(reason)]) == (0, 3, reason)
    assert [publisher.plan for publisher in publishers] == before


def test_what_a_relay_has_carried_is_counted_when_it_is_told(node, announced, eventually):
    """Each snapshot asks the relay again: an older count would look like cross traffic."""
    carried = count(1)
    NodePublishers.of(node).relay = lambda: RelaySummary(link_bytes=next(carried))
    eventually("two snapshots arrive", lambda: len(announced.link_bytes) > 1)
    assert announced.link_bytes[1] > announced.link_bytes[0]


def test_a_topic_that_is_given_back_serves_a_reader_that_its_plan_lost(ros, node, send, answers, eventually):
    """A reader that requests the application's deadline hears nothing under a longer one, and all once it is back."""
    own = QoSProfile(depth=10, deadline=Duration(nanoseconds=90_000_000))
    publisher, received = AdaptivePublisher(node, String, A, own), []
    send(3, {A: ROW})
    eventually("the plan is in force", lambda: publisher.state().deadline_ns == ROW.deadline_ns)
    ros.node("reader").create_subscription(String, A, received.append, own)
    eventually("the reader is refused", publisher._flow.swap.current.refusals)
    assert publisher.get_subscription_count() == 0
    send(4, {A: replace(ROW, rate_hz=math.inf, depth=0, deadline_ns=0)})
    answers(4)
    eventually("the reader matches", lambda: publisher.get_subscription_count() == 1)
    publisher.publish(String(data="heard"))
    eventually("it hears", lambda: received)
    assert (publisher.state().depth, publisher.state().deadline_ns) == (10, 90_000_000)


def test_publishers_beyond_what_a_node_may_tell_are_counted(node, announced, eventually, monkeypatch):
    """A node with more publishers than a daemon takes tells of the first, and how many there are beside them."""
    monkeypatch.setattr(node_publishers, "MOST_PUBLISHERS", 2)
    publishers = [AdaptivePublisher(node, String, f"/t{number}", 10) for number in range(4)]
    eventually("two are counted", lambda: [each.left_out for each in announced.snapshots] == [len(publishers) - 2])
    assert [state.topic for state in announced.states] == ["/t0", "/t1"]


def test_a_publisher_that_comes_while_the_others_are_listed_disturbs_nothing():
    """To make a tuple of them may collect garbage first, and then another thread runs, and makes one."""
    publishers, before = NodePublishers.__new__(NodePublishers), gc.get_threshold()
    publishers._publishers = dict.fromkeys(map(str, range(100)))

    def make_one(phase, _info):
        publishers._publishers |= {f"{phase}{len(publishers._publishers)}": None}

    gc.callbacks.append(make_one)
    try:
        for threshold in range(1, 50):
            gc.set_threshold(threshold)
            assert len(publishers._all) >= 100
    finally:
        gc.callbacks.remove(make_one)
        gc.set_threshold(*before)
