"""Writers and readers of a topic take a plan without losing each other."""

import math
import random
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.ordering import PATIENCE_S, Ordering, Steps
from arpd.apply.readers import plan_readers
from arpd.model.plan import QosPlan, TopicPlan
from tests.examples import examples
from tests.sample_publishers import publisher, reader

TOPIC = "/t"
MS = 1_000_000
SHORT, LONG = 80 * MS, 500 * MS


def row(deadline_ns, depth=20, rate_hz=5.0):
    return TopicPlan(rate_hz=rate_hz, min_rate_hz=1.0, deadline_ns=deadline_ns, depth=depth)


def period(deadline_ns):
    return deadline_ns or math.inf


class Endpoint:
    """A writer or reader that takes its parameter calls when the test says so."""

    def __init__(self, state):
        self.state = self.announced = state
        self.inbox = []
        self.wanted = None

    def send(self, generation, wanted):
        """Make a parameter call, unless the same is under way."""
        if self.inbox[-1:] != [(generation, wanted)]:
            self.inbox.append((generation, wanted))

    def receive(self):
        """Take the next parameter call; its QoS is in force later."""
        if self.inbox:
            generation, wanted = self.inbox.pop(0)
            if generation >= self.state.generation:
                rate = {"rate_hz": wanted.rate_hz} if isinstance(wanted, TopicPlan) else {}
                self.state, self.wanted = replace(self.state, generation=generation, **rate), wanted

    def lose(self):
        del self.inbox[:1]

    def swap(self):
        if self.wanted is not None:
            self.state = replace(self.state, depth=self.wanted.depth, deadline_ns=self.wanted.deadline_ns)
            self.wanted = None

    def answer(self):
        """Take every parameter call, and bring the last one into force."""
        while self.inbox:
            self.receive()
        self.swap()

    def announce(self):
        self.announced = self.state


class World:
    """A topic with its endpoints, and a daemon that sees only what they announce."""

    def __init__(self, writers, readers):
        self.writers = [Endpoint(state) for state in writers]
        self.readers = [Endpoint(state) for state in readers]
        self.ordering = Ordering()
        self.plan = QosPlan(generation=0, topics={}, level_bytes_per_second=1.0)
        self.now_s = 0.0
        self.steps = Steps(transitions=(), confirmed=0, readers_confirmed=0)

    @property
    def endpoints(self):
        return [*self.writers, *self.readers]

    def intend(self, wanted):
        self.plan = QosPlan(generation=self.plan.generation + 1, topics={TOPIC: wanted}, level_bytes_per_second=1.0)

    def tick(self, seconds=0.1):
        self.now_s += seconds
        readers = [each.announced for each in self.readers]
        self.steps = self.ordering.steps(
            self.now_s,
            publishers=[each.announced for each in self.writers],
            readers=readers,
            plan=self.plan,
            reader_plans=plan_readers(readers, self.plan),
            reason="test",
        )
        for step in self.steps.transitions:
            for each in self.writers:
                if each.state.node == step.node and step.topics:
                    each.send(step.generation, step.topics[TOPIC])
            for each in self.readers:
                if each.state.node == step.node and step.readers:
                    each.send(step.generation, step.readers[TOPIC])

    def heard(self):
        """Return the pairs that are compatible."""
        return {
            (i, k)
            for i, writer in enumerate(self.writers)
            for k, listener in enumerate(self.readers)
            if period(writer.state.deadline_ns) <= period(listener.state.deadline_ns)
        }


def writer_at(deadline_ns, node="/w", **fields):
    return publisher(node, TOPIC, deadline_ns=deadline_ns, rate_hz=20.0, **fields)


def reader_at(deadline_ns, node="/r", **fields):
    return reader(node, TOPIC, **{"deadline_ns": deadline_ns, "baseline_deadline_ns": 100 * MS, **fields})


@examples(60)
@given(st.integers(1, 2), st.integers(1, 2), st.integers(0, 2**32))
def test_no_order_of_answers_separates_a_pair(writers, readers, seed):
    """A reader that hears a writer goes on hearing it, in any order of answers and without some of them."""
    chance = random.Random(seed)

    def deadline_ns():
        return chance.choice([0, 50, 100, 400, 800]) * MS

    world = World(
        [writer_at(deadline_ns(), node=f"/w{i}") for i in range(writers)],
        [reader_at(ns := deadline_ns(), node=f"/r{i}", baseline_deadline_ns=ns or 1) for i in range(readers)],
    )
    for _ in range(300):
        heard = world.heard()
        match chance.choices(["answer", "tick", "announce", "intend", "lose", "wait"], [40, 40, 20, 4, 2, 1])[0]:
            case "intend":
                world.intend(row(deadline_ns()))
            case "tick":
                world.tick()
            case "wait":
                world.tick(PATIENCE_S)
            case "announce":
                chance.choice(world.endpoints).announce()
            case "lose":
                chance.choice(world.endpoints).lose()
            case "answer":
                getattr(chance.choice(world.endpoints), chance.choice(["receive", "swap"]))()
        assert heard <= world.heard()


def test_a_node_that_forgot_its_plan_is_asked_again():
    """A publisher that returns with the planned QoS, but without a plan, lacks its terms."""
    ordering = Ordering()
    planned = replace(row(0, depth=10), rate_hz=math.inf, weight=2.0)
    plan = QosPlan(generation=3, topics={TOPIC: planned}, level_bytes_per_second=1.0)

    def steps(generation):
        publishers = (publisher("/n", TOPIC, generation=generation),)
        return ordering.steps(0.0, publishers=publishers, readers=(), plan=plan, reader_plans={}, reason="test")

    assert steps(0).transitions
    assert not steps(3).transitions
    assert steps(0).transitions, "the node was restarted"
    assert not steps(3).transitions
