"""When an announcer sends statuses and numbers, over a node that only keeps them."""

from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from types import SimpleNamespace

from rclpy.serialization import serialize_message

from arpd.adapters.ros import announcer as module
from arpd.adapters.ros.announcement import from_status, tag_of
from arpd.adapters.ros.announcer import Announcer
from arpd.adapters.ros.counters import decode_counters
from arpd.adapters.ros.plan_message import PlanAnswer
from tests.sample_publishers import publisher

pytestmark = pytest.mark.ros
ANSWER = PlanAnswer(generation=3, crc=9)


class World:
    """A node with publishers, a clock, and everything that was sent."""

    def __init__(self, monkeypatch, publishers=1):
        self.listeners = 0
        monkeypatch.setattr(module, "status_of", lambda *_: SimpleNamespace(total_count=self.listeners))
        self.states = {number: publisher("/n", f"/t{number}") for number in range(publishers)}
        self.statuses, self.counters = [], []
        self.now_s = 100.0
        stamp = SimpleNamespace(to_msg=SimpleNamespace)
        node = SimpleNamespace(
            get_fully_qualified_name=lambda: "/n",
            get_clock=lambda: SimpleNamespace(now=lambda: stamp),
            create_publisher=self._create,
        )
        monkeypatch.setattr(module, "DiagnosticArray", lambda: SimpleNamespace(header=SimpleNamespace(), status=[]))
        self.announcer = Announcer(node, self.states.__getitem__)

    def _create(self, _kind, topic, _qos, **_events):
        sent = self.statuses if topic == "/arpd/publishers" else self.counters
        return SimpleNamespace(publish=lambda message: sent.append((self.now_s, message)))

    def run(self, for_s):
        """Let the pacing thread turn whenever something is due; return what it sent, with the times since."""
        begun_s, end_s = self.now_s, self.now_s + for_s
        self.statuses.clear()
        self.counters.clear()
        while (due_s := max(self.now_s, self.announcer.due_s)) < end_s - 1e-6:
            self.now_s = due_s
            self.announcer.turn(self.now_s, list(self.states), answer=ANSWER, lease_s=5.0)
        self.now_s = end_s
        return [
            (round(at_s - begun_s, 2), [from_status(status).topic for status in message.status])
            for at_s, message in self.statuses
        ]

    def rows(self):
        return [decode_counters(bytes(message.data)).rows for _, message in self.counters]


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


def test_what_does_not_change_is_said_rarely(world):
    """A publisher is announced at once, and about every eight to fifteen seconds from then on."""
    assert world.run(7.0) == [(0.0, ["/t0"])]
    assert len(world.counters) == 7
    assert 3 <= len(world.run(40.0)) <= 5


def test_numbers_are_no_news_and_qos_is(world):
    """Counters and rates leave as numbers only; another depth or refusal leaves at once as a status."""
    world.run(1.0)
    world.states[0] = replace(
        world.states[0], offered=50, published=40, paced_rate_hz=3.0, rate_hz=5.0, generation=3, lease_s=5.0
    )
    assert world.run(1.0) == []
    ((row,),) = world.rows()
    assert row.changes({"offered": 0, "published": 0}) == {
        "offered": 50,
        "published": 40,
        "paced_rate_hz": 3.0,
        "rate_hz": 5.0,
    }
    for changed in ({"depth": 20}, {"refusal": "no"}, {"swaps_by_result": {"ok": 1}}, {"deadline_ns": 5}):
        world.states[0] = replace(world.states[0], **changed)
        assert world.run(1.0) == [(0.0, ["/t0"])]
    assert world.rows()[0][0].mask == 0, "numbers count from the newest status"


def test_a_joining_listener_hears_all_in_small_messages_with_pauses(monkeypatch):
    """All statuses leave within two seconds, at most 32 kB at once, and five times a second."""
    world = World(monkeypatch, publishers=200)
    world.run(5.0)
    world.listeners += 1
    sent = world.run(2.0)
    assert sorted(topic for _, topics in sent for topic in topics) == sorted(
        state.topic for state in world.states.values()
    )
    assert [len(topics) for _, topics in sent] == [32] * 6 + [8]
    assert [at_s for at_s, _ in sent] == [round(0.2 * number, 2) for number in range(7)]
    assert world.run(2.0) == []


def test_repetitions_are_spread(monkeypatch):
    """The statuses of many publishers are repeated a few a second."""
    world = World(monkeypatch, publishers=150)
    world.run(8.0)
    sent = world.run(30.0)
    assert max(len(topics) for _, topics in sent) <= 10
    assert 250 <= sum(len(topics) for _, topics in sent) <= 300


def test_news_do_not_wait_for_repetitions(monkeypatch):
    """Of two hundred due statuses that with news comes first."""
    world = World(monkeypatch, publishers=200)
    world.run(5.0)
    world.listeners += 1
    world.states[199] = replace(world.states[199], depth=20)
    assert world.run(0.2)[0][1][0] == "/t199"
    world.announcer.hurry(198)
    assert world.run(0.2)[0][1][0] == "/t198"


def test_an_answer_does_not_wait_for_the_second(world):
    """Numbers with the answer to a plan leave a fifth of a second after the last ones."""
    world.run(1.1)
    world.announcer.hurry_answer()
    world.run(0.3)
    assert [decode_counters(bytes(message.data)).answer for _, message in world.counters] == [ANSWER]


def test_numbers_of_publishers_are_never_reused(world):
    """A publisher that returns under the same name is another one, with another number."""
    world.run(1.0)
    (_, first), *_ = world.statuses
    state = world.states.pop(0)
    world.run(1.0)
    assert world.rows() == [[]]
    world.states[0] = state
    world.run(1.0)
    (_, second), *_ = world.statuses
    assert [tag_of(message.status[0]).number for message in (first, second)] == [1, 2]


def test_a_message_of_statuses_is_at_most_32_kilobytes():
    """Thirty-two statuses with everything that can be said fit into it."""
    from tests.ros.test_announce import REPLACED

    tag = module.Tag(2**64 - 1, 2**32 - 1, 255)
    assert 32 * len(serialize_message(module.to_status(REPLACED, tag))) < 40_000
