"""Times and answers of plan messages, over a node that only keeps them."""

import logging
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.ros.plan_message import PlanAnswer, crc_of, decode_plan
from arpd.adapters.ros.plan_sender import PlanSender
from arpd.model.plan import ReaderPlan, TopicPlan, Transition

pytestmark = pytest.mark.ros
ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=20, weight=2.0, wire_bytes=1500.5, packets=3)
STEP = Transition(node="/n", generation=3, topics={"/t": ROW}, reason="test", lease_s=4.0)
TO_READERS = Transition(
    node="/n", generation=3, topics={}, readers={"/t": ReaderPlan(depth=7, deadline_ns=9)}, reason="test", lease_s=4.0
)


class Node:
    """A node whose plans the test receives and answers."""

    def __init__(self):
        self.topics, self.texts, self.destroyed = [], [], 0
        self.readers = 1
        self.publishers_answer = self.readers_answer = PlanAnswer()
        self.fault = None

    def create_publisher(self, _kind, topic, _qos, **_events):
        self.topics.append(topic)
        return self

    def publish(self, message):
        if self.fault is not None:
            raise self.fault
        self.texts.append(message.data)

    def get_subscription_count(self):
        return self.readers

    def destroy_publisher(self, _publisher):
        self.destroyed += 1

    def answer(self, refusal="", generation=3):
        return PlanAnswer(generation, crc_of(self.texts[-1]), refusal)


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def sender(node):
    return PlanSender(
        node, publishers_answer=lambda _name: node.publishers_answer, readers_answer=lambda _name: node.readers_answer
    )


@pytest.mark.parametrize(
    ("is_answered", "expected_s"), [(False, [0.0, 2.5, 7.5, 17.5]), (True, [0.0, 6.0, 12.0])], ids=["no", "yes"]
)
def test_an_unconfirmed_plan_is_repeated_after_a_while(node, sender, is_answered, expected_s):
    """Without an answer a plan is repeated with growing back-off; an accepted one after the time of a swap."""
    sent_s = []
    for tick in range(180):
        before = len(node.texts)
        sender.apply([STEP], now_s=tick / 10)
        if len(node.texts) > before:
            sent_s.append(tick / 10)
            if is_answered:
                node.publishers_answer = node.answer()
    assert sent_s == expected_s
    assert len(set(node.texts)) == 1


def test_a_plan_has_all_rows_of_a_node(node, sender):
    """One message has the rows of a node's publishers and readers, its generation and its lease."""
    sender.apply([STEP, TO_READERS], now_s=0.0)
    assert node.topics == ["/arpd/plan/n"]
    plan = decode_plan(*node.texts)
    assert (plan.generation, plan.lease_s) == (3, 4.0)
    assert TopicPlan(**plan.publishers["/t"]) == ROW
    assert ReaderPlan(**plan.readers["/t"]) == TO_READERS.readers["/t"]


def test_other_rows_go_out_at_once(node, sender):
    """New rows wait neither for the back-off nor for an answer, but messages keep a distance."""
    sender.apply([STEP], now_s=0.0)
    other = replace(STEP, topics={"/t": replace(ROW, deadline_ns=50_000)})
    sender.apply([other], now_s=0.1)
    assert len(node.texts) == 1
    sender.apply([other], now_s=0.25)
    assert decode_plan(node.texts[-1]).publishers["/t"]["deadline_ns"] == 50_000


def test_answers_are_counted_by_result(node, sender, caplog):
    """An accepted plan is ok for publishers and readers each, and a refusal is logged in one short line."""
    sender.apply([STEP, TO_READERS], now_s=0.0)
    assert sender.results == {}
    node.publishers_answer = node.answer()
    sender.apply([], now_s=0.1)
    assert sender.results == {"ok": 1}
    node.readers_answer = node.answer(refusal="it would lose publishers")
    with caplog.at_level(logging.WARNING):
        sender.apply([], now_s=0.2)
        sender.apply([], now_s=9.0)
    assert sender.results == {"ok": 1, "refused": 1}
    assert [record.getMessage() for record in caplog.records] == ["/n refused plan 3: 'it would lose publishers'"]


@pytest.mark.parametrize(("readers", "result"), [(1, "timeout"), (0, "unreachable")])
def test_a_missing_answer_is_counted_once(node, sender, readers, result):
    """Without an answer to this plan a node counts as a timeout, and without a subscription as unreachable."""
    node.readers = readers
    sender.apply([STEP], now_s=0.0)
    node.publishers_answer = PlanAnswer(3, crc_of(node.texts[0]) ^ 1, "")
    for tick in range(24):
        sender.apply([], now_s=tick / 10)
    assert sender.results == {}
    sender.apply([], now_s=2.6)
    sender.apply([], now_s=20.0)
    assert sender.results == {result: 1}


def test_an_answer_of_a_node_that_forgot_the_plan_is_none(node, sender):
    """A node whose lease ended has the text, but not the plan."""
    sender.apply([STEP], now_s=0.0)
    node.publishers_answer = node.answer(generation=0)
    sender.apply([], now_s=1.0)
    assert sender.results == {}


def test_a_message_that_cannot_be_sent_holds_no_other(node, sender):
    """A fault of the middleware counts, and the plan goes out later."""
    node.fault = RuntimeError("no memory")
    sender.apply([STEP], now_s=0.0)
    node.fault = None
    sender.apply([], now_s=1.0)
    sender.apply([STEP], now_s=2.5)
    assert (sender.results, len(node.texts)) == ({"failed": 1}, 1)


def test_nodes_without_end_take_no_memory_without_end(node, sender):
    """Beyond the limit of nodes those used longest ago are forgotten."""
    for k in range(600):
        sender.apply([replace(STEP, node=f"/n{k}")], now_s=0.0)
    assert node.destroyed == 100
    sender.apply([replace(STEP, node="/n599")], now_s=0.1)
    assert len(node.texts) == 600
