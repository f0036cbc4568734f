"""When the plan is sent, and what its answers count as, over a node that only keeps the messages."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from arpd.model.plan import NO_PLAN, PlanAnswer, QosPlan, TopicPlan
from arpd.ros.plan_sender import PlanSender

ROW = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=0, depth=20, weight=2.0, wire_bytes=1500.5, packets=3)
PLAN = QosPlan(generation=3, topics={"/t": ROW}, level_bytes_per_second=1.0)


class Node:
    """A node that keeps what it should publish."""

    def __init__(self):
        self.messages = []

    def create_publisher(self, _kind, _topic, _qos, **_events):
        return self

    def publish(self, message):
        self.messages.append(message)

    def destroy_publisher(self, _publisher):
        self.messages.clear()


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def send(node):
    """Let the sender have a turn; return how many messages it has sent so far."""
    sender = PlanSender(node)

    def send(now_s, *, plan=PLAN, missing=("/n",), answer=NO_PLAN):
        sender.apply(plan, lease_s=4.0, missing=missing, answers={"/n": answer}, now_s=now_s)
        return len(node.messages)

    send.sender = sender
    return send


def test_an_unconfirmed_plan_is_sent_again_after_a_while(node, send):
    """The same message goes out until the nodes show it, after 6 s and then 12 s; then it rests."""
    counts = [send(tick / 10) for tick in range(320)]
    assert [counts.index(number) / 10 for number in sorted({*counts})] == [0.0, 6.0, 18.0, 30.0]
    assert len(set(node.messages)) == 1
    assert send.sender.results == {"timeout": 3}
    assert {send(tick, missing=(), answer=PlanAnswer(3)) for tick in range(40, 100)} == {4}
    assert send.sender.results == {"timeout": 3, "ok": 1}


def test_a_new_plan_does_not_wait(send):
    """Other rows, or another lease, go out at once, but not more than five times a second."""
    send(0.0)
    other = QosPlan(generation=4, topics={}, level_bytes_per_second=1.0)
    assert [send(now_s, plan=other) for now_s in (0.1, 0.2, 0.3)] == [1, 2, 2]


def test_an_answer_counts_once(send):
    """A refusal of this plan counts, not again when that is sent again, and one of another does not."""
    send(0.0)
    send(0.5, answer=PlanAnswer(2, 0.0, 1, "too old"))
    assert send.sender.results == {}
    for now_s in (1.0, 1.5, 6.0, 6.5):
        send(now_s, answer=PlanAnswer(2, 0.0, 3, "/t: depth"))
    assert send.sender.results == {"refused": 1}
    for now_s in (7.0, 18.0, 18.5):
        send(now_s, answer=PlanAnswer(3))
    assert send.sender.results == {"refused": 1, "ok": 1}


def test_a_plan_that_is_taken_back_is_sent_anew(node, send):
    """Who stands by leaves no plan behind, and sends it again when it drives."""
    send(0.0)
    send.sender.forget()
    assert not node.messages
    assert send(1.0) == 1
