"""A plan reaches every publisher, and no node is asked for what it has."""

import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.progress import Progress
from arpd.model.plan import QosPlan, TopicPlan
from tests.examples import examples
from tests.sample_publishers import publisher

TOPICS = ("/a", "/b")
MS = 1_000_000


def row(deadline_ns=0, depth=10, **changes):
    return TopicPlan(rate_hz=math.inf, min_rate_hz=1.0, deadline_ns=deadline_ns, depth=depth, **changes)


def plan_of(generation, wanted):
    return QosPlan(generation=generation, topics=dict.fromkeys(TOPICS, wanted), level_bytes_per_second=1.0)


class World:
    """Publishers of two nodes, and a daemon that sees only what they announce."""

    def __init__(self):
        self.progress, self.wanted, self.generation = Progress(), row(), 1
        self.inbox = {}
        self.taken = dict.fromkeys(TOPICS)  # the row that each has taken last
        self.real = {topic: publisher(f"/n{topic[1]}", topic) for topic in TOPICS}
        self.told = dict(self.real)

    def plan(self, deadline_ns):
        self.wanted, self.generation = replace(self.wanted, deadline_ns=deadline_ns), self.generation + 1

    def terms(self, weight):
        self.wanted, self.generation = replace(self.wanted, weight=weight), self.generation + 1

    def take(self, topic):
        number, asked = self.inbox.pop(topic, (-1, None))
        if number >= self.real[topic].generation:
            self.taken[topic] = asked
            taken = {"generation": number, "depth": asked.depth, "deadline_ns": asked.deadline_ns}
            self.real[topic] = replace(self.real[topic], **taken)

    def announce(self, topic):
        self.told[topic] = self.real[topic]

    def restart(self, topic):
        self.real[topic], self.taken[topic] = publisher(f"/n{topic[1]}", topic), None
        self.inbox.pop(topic, None)

    def turn(self):
        found = self.progress.steps(
            publishers=tuple(self.told.values()), plan=plan_of(self.generation, self.wanted), reason="test"
        )
        for step in found.transitions:
            self.inbox.update({topic: (step.generation, asked) for topic, asked in step.topics.items()})
        return found


@examples(60)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("plan"), st.sampled_from([0, 50 * MS, 100 * MS])),
            st.tuples(st.just("terms"), st.sampled_from([1.0, 2.0])),
            st.tuples(st.sampled_from(["take", "announce", "restart"]), st.sampled_from(TOPICS)),
        ),
        max_size=40,
    )
)
def test_whatever_happens_a_plan_is_in_force_at_last(steps):
    """Plans, answers and restarts in any order: asked until it answers, each node has the newest rows, and rests."""
    world = World()
    for what, value in steps:
        getattr(world, what)(value)
        world.turn()
    for _ in range(3):
        for topic in TOPICS:
            world.take(topic)
            world.announce(topic)
        last = world.turn()
    assert not last.transitions
    assert last.confirmed == len(TOPICS)
    assert list(world.taken.values()) == [world.wanted, world.wanted]


def test_a_node_that_forgot_its_plan_is_asked_again():
    """A publisher that returns with the planned QoS, but without a plan, lacks its terms."""
    progress = Progress()
    plan = plan_of(3, row(weight=2.0))

    def steps(generation):
        return progress.steps(publishers=(publisher("/n", "/a", generation=generation),), plan=plan, reason="test")

    assert steps(0).transitions
    assert not steps(3).transitions
    assert steps(0).transitions, "the node was restarted"
    assert not steps(3).transitions
