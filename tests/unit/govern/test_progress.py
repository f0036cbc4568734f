"""How far a plan has come by what nodes tell."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.progress import is_confirmed, progress
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import QosPlan, TopicPlan
from tests.examples import examples
from tests.sample_publishers import publisher

TOPICS = ("/a", "/b")
MS = 1_000_000
PUBLISHER = publisher("/n", "/t")


def row(deadline_ns=0, depth=10, **changes):
    return TopicPlan(rate_hz=math.inf, min_rate_hz=1.0, deadline_ns=deadline_ns, depth=depth, **changes)


def plan_of(generation, wanted, topics=TOPICS):
    return QosPlan(generation=generation, topics=dict.fromkeys(topics, wanted), level_bytes_per_second=1.0)


def taken(publisher, plan):
    """Return what a publisher tells once its node has taken a plan."""
    if publisher.generation > plan.generation or (wanted := plan.topics.get(publisher.topic)) is None:
        return publisher
    return replace(
        publisher,
        generation=plan.generation,
        rate_hz=wanted.rate_hz,
        depth=wanted.depth,
        deadline_ns=wanted.deadline_ns,
    )


class World:
    """Publishers of two nodes, which take the last plan that was sent, and a daemon that sees only what they tell."""

    def __init__(self):
        self.wanted, self.generation = row(), 1
        self.sent = None
        self.terms = dict.fromkeys(TOPICS)  # the row that each has taken last
        self.real = {topic: publisher(f"/n{topic[1]}", topic) for topic in TOPICS}
        self.told = dict(self.real)

    def plan(self, deadline_ns):
        self.wanted, self.generation = replace(self.wanted, deadline_ns=deadline_ns), self.generation + 1

    def reweigh(self, weight):
        self.wanted, self.generation = replace(self.wanted, weight=weight), self.generation + 1

    def take(self, topic):
        if self.sent is not None:
            self.real[topic], self.terms[topic] = taken(self.real[topic], self.sent), self.sent.topics[topic]

    def tell(self, topic):
        self.told[topic] = self.real[topic]

    def restart(self, topic):
        self.real[topic], self.terms[topic] = publisher(f"/n{topic[1]}", topic), None

    def turn(self):
        plan = plan_of(self.generation, self.wanted)
        come = progress(tuple(self.told.values()), plan)
        if come.missing:
            self.sent = plan
        return come


@examples(60)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("plan"), st.sampled_from([0, 50 * MS, 100 * MS])),
            st.tuples(st.just("reweigh"), st.sampled_from([1.0, 2.0])),
            st.tuples(st.sampled_from(["take", "tell", "restart"]), st.sampled_from(TOPICS)),
        ),
        max_size=40,
    )
)
def test_whatever_happens_a_plan_is_in_force_at_last(steps):
    """Plans, answers and restarts in any order: sent until all show it, each node has the newest rows, terms too."""
    world = World()
    for what, value in steps:
        getattr(world, what)(value)
        world.turn()
    for _ in range(3):
        for topic in TOPICS:
            world.take(topic)
            world.tell(topic)
        last = world.turn()
    assert not last.missing
    assert last.confirmed == len(TOPICS)
    assert list(world.terms.values()) == [world.wanted, world.wanted]


def test_a_node_that_forgot_its_plan_is_asked_again():
    """A publisher that returns with the planned QoS, but without a plan, lacks its terms."""
    plan = plan_of(3, row(weight=2.0))
    assert progress([publisher("/n", "/a", generation=0)], plan).missing == {"/n"}
    assert not progress([publisher("/n", "/a", generation=3)], plan).missing


def test_a_lease_is_a_part_of_the_plan():
    """A node that shows another lease lacks the plan; told times have six digits."""
    plan = plan_of(3, row())
    leased = publisher("/n", "/a", generation=3, lease_s=33.3333)
    assert progress([leased], plan, lease_s=0.0).missing == {"/n"}
    assert not progress([leased], plan, lease_s=100 / 3).missing


TARGET = TopicPlan(rate_hz=12.3456789, min_rate_hz=1.0, deadline_ns=5, depth=3)
SHOWN = replace(PUBLISHER, rate_hz=12.3457, depth=3, deadline_ns=5)  # told rates have six digits


@pytest.mark.parametrize(
    ("shown", "is_enough"),
    [
        (SHOWN, True),
        (replace(SHOWN, depth=4), False),
        (replace(SHOWN, depth=4, keeps_all=True), True),
        (replace(SHOWN, deadline_ns=6, keeps_all=True), False),
        *(
            (replace(SHOWN, depth=4, rate_hz=rate_hz, refusal="no", refusal_reason=reason), near and reason.is_lasting)
            for reason in RefusalReason
            for rate_hz, near in ((12.3457, True), (6.0, False))
        ),
    ],
)
def test_a_publisher_confirms_what_it_can_have(shown, is_enough):
    """KEEP_ALL has no depth to confirm, and after a lasting refusal the ceiling is enough, after a passing one not."""
    assert is_confirmed(shown, TARGET) == is_enough
