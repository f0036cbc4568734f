"""Times and answers of plan messages, over a node that only keeps them."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.adapters.ros.plan_message import PlanAnswer, crc_of
from arpd.adapters.ros.plan_sender import PlanSender
from arpd.model.plan import TopicPlan, Transition

ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=20, weight=2.0, wire_bytes=1500.5, packets=3)
STEP = Transition(node="/n", generation=3, topics={"/t": ROW}, reason="test", lease_s=4.0)


class Node:
    """A node whose plans the test receives and answers."""

    def __init__(self):
        self.texts = []
        self.readers = 1
        self.last_answer = PlanAnswer()

    def create_publisher(self, _kind, _topic, _qos, **_events):
        return self

    def publish(self, message):
        self.texts.append(message.data)

    def get_subscription_count(self):
        return self.readers

    def answer(self, refusal=""):
        return PlanAnswer(3, crc_of(self.texts[-1]), refusal)


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def sender(node):
    return PlanSender(node, answer_of=lambda _name: node.last_answer)


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
                node.last_answer = node.answer()
    assert sent_s == expected_s
    assert len(set(node.texts)) == 1
