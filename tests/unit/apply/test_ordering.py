"""Writers and readers of a topic take a plan without losing each other."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.apply.ordering import PATIENCE_S, Ordering, Steps
from arpd.apply.readers import is_reader_confirmed, plan_readers, restore_readers
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import QosPlan, ReaderPlan, TopicPlan
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

    def settle(self, among=None):
        """Let the endpoints answer until nothing is left to send."""
        for _ in range(30):
            self.tick()
            if not self.steps.transitions:
                return
            for each in among or self.endpoints:
                each.answer()
                each.announce()
        raise AssertionError("it never settles")

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


DEADLINES = st.one_of(st.just(0), st.integers(1, 2000)).map(lambda ms: ms * MS)


@settings(deadline=None, max_examples=60)
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


@settings(deadline=None)
@given(st.lists(DEADLINES, min_size=1, max_size=2), st.lists(DEADLINES, min_size=1, max_size=3), st.lists(DEADLINES))
def test_where_everybody_answers_everybody_comes_to_the_plan(offers, requests, plans):
    """In the end writers offer the plan's period, and readers request a longer one, or none if they never did."""
    world = World(
        [writer_at(ns, node=f"/w{i}") for i, ns in enumerate(offers)],
        [reader_at(ns, node=f"/r{i}", baseline_deadline_ns=ns) for i, ns in enumerate(requests)],
    )
    for deadline_ns in (*plans, SHORT):
        world.intend(row(deadline_ns))
        world.settle()
        assert all(writer.state.deadline_ns == deadline_ns for writer in world.writers)
        assert len(world.heard()) == len(offers) * len(requests)
        assert (world.steps.confirmed, world.steps.readers_confirmed) == (len(offers), len(requests))
    for listener, asked_ns in zip(world.readers, requests, strict=True):
        assert listener.state.deadline_ns == (120 * MS if asked_ns else 0)
        assert listener.state.depth == 20


def sent(world):
    return [("readers" if step.readers else "writers") for step in world.steps.transitions]


def test_relaxing_moves_readers_first_and_the_ceiling_at_once():
    """The writer has its new ceiling at once, and keeps its QoS until the reader has relaxed."""
    world = World([writer_at(SHORT)], [reader_at(100 * MS)])
    world.intend(row(LONG))
    world.tick()
    (to_writer, to_reader) = world.steps.transitions
    assert to_writer.topics[TOPIC] == replace(row(SHORT, depth=10), rate_hz=5.0)
    assert to_reader.readers[TOPIC] == ReaderPlan(depth=20, deadline_ns=750 * MS)
    for each in world.endpoints:
        each.answer()
    world.writers[0].announce()
    world.tick()
    assert sent(world) == ["readers"]
    assert world.steps.confirmed == 0
    world.readers[0].announce()
    world.tick()
    assert sent(world) == ["writers"]
    assert world.steps.transitions[0].topics[TOPIC] == row(LONG)


def test_tightening_moves_writers_first():
    """The reader keeps its request until every writer it hears offers a period no longer than the new one."""
    world = World([writer_at(LONG, node="/a"), writer_at(LONG, node="/b")], [reader_at(750 * MS)])
    world.intend(row(SHORT))
    world.tick()
    assert sent(world) == ["writers", "writers"]
    for each in world.writers:
        each.answer()
    world.writers[0].announce()
    world.tick()
    assert sent(world) == ["writers"]
    world.writers[1].announce()
    world.tick()
    assert sent(world) == ["readers"]
    assert world.steps.transitions[0].readers[TOPIC].deadline_ns == 120 * MS


def test_a_reader_that_does_not_answer_holds_nobody_back_for_ever():
    """After the patience the writer offers what that reader requests, and its whole row once the reader answers."""
    world = World([writer_at(SHORT)], [reader_at(100 * MS, node="/deaf"), reader_at(100 * MS, node="/r")])
    world.intend(row(LONG))
    willing = [world.writers[0], world.readers[1]]
    world.tick()
    world.tick(PATIENCE_S + 0.1)
    for _ in range(3):
        for each in willing:
            each.answer()
            each.announce()
        world.tick()
    assert world.writers[0].state.deadline_ns == 100 * MS
    assert world.writers[0].state.depth == 20
    assert (world.steps.confirmed, world.steps.readers_confirmed) == (1, 1)
    assert sent(world) == ["readers"]
    world.settle()
    assert world.writers[0].state.deadline_ns == LONG


def test_a_writer_that_does_not_answer_leaves_its_reader_what_it_hears():
    """After the patience the reader has the planned depth, and requests what that writer still offers."""
    world = World([writer_at(LONG)], [reader_at(750 * MS)])
    world.intend(row(SHORT))
    world.tick()
    world.tick(PATIENCE_S + 0.1)
    (step,) = (step for step in world.steps.transitions if step.readers)
    assert step.readers[TOPIC] == ReaderPlan(depth=20, deadline_ns=LONG)


@pytest.mark.parametrize(("offers_ns", "waits"), [((SHORT, LONG), True), ((SHORT,), False), ((0,), False)])
def test_a_writer_that_only_the_graph_knows_counts_if_it_is_heard(offers_ns, waits):
    """A reader does not request less than an unmodified writer offers, unless it never heard that writer."""
    world = World([writer_at(SHORT, depth=20)], [reader_at(750 * MS, offers_ns=offers_ns)])
    world.intend(row(SHORT, rate_hz=20.0))
    world.tick()
    assert ("readers" in sent(world)) != waits


def test_a_reader_that_the_graph_still_shows_counts():
    """A writer waits until the replaced reader is gone from the graph too."""
    world = World([writer_at(SHORT)], [reader_at(750 * MS, depth=20, requests_ns=(100 * MS, 750 * MS))])
    world.intend(row(LONG))
    world.settle(among=world.writers)
    assert world.writers[0].state.deadline_ns == SHORT
    world.readers[0].state = replace(world.readers[0].state, requests_ns=(750 * MS,))
    world.readers[0].announce()
    world.settle()
    assert world.writers[0].state.deadline_ns == LONG


def test_a_reader_that_refuses_for_good_is_left_alone():
    """A reader with a lasting refusal gets no row, neither of a plan nor of a restore."""
    latched = reader_at(100 * MS, refusal="no", refusal_reason=RefusalReason.TRANSIENT_LOCAL, generation=3)
    plan = QosPlan(generation=1, topics={TOPIC: row(LONG)}, level_bytes_per_second=1.0)
    assert (plan_readers([latched], plan), restore_readers([latched])) == ({}, {})


def test_a_reader_that_keeps_all_has_no_depth_to_change():
    """Only the deadline of a KEEP_ALL reader is planned."""
    everything = reader_at(100 * MS, depth=7, keeps_all=True)
    plan = QosPlan(generation=1, topics={TOPIC: row(LONG)}, level_bytes_per_second=1.0)
    (wanted,) = plan_readers([everything], plan).values()
    assert wanted == ReaderPlan(depth=7, deadline_ns=750 * MS)
    assert is_reader_confirmed(replace(everything, depth=1, deadline_ns=750 * MS), wanted)


def test_restoring_gives_readers_what_their_application_asked_for():
    """Only readers that carry a plan are restored."""
    planned = reader_at(750 * MS, depth=20, generation=4)
    assert restore_readers([planned, reader_at(1, node="/own")]) == {
        ("/r", TOPIC): ReaderPlan(depth=10, deadline_ns=100 * MS)
    }


def test_the_lease_reaches_readers_too():
    """A reader that has the plan is sent a changed lease until it announces it."""
    settled = reader_at(750 * MS, depth=20, generation=1)
    plan = QosPlan(generation=1, topics={TOPIC: row(LONG)}, level_bytes_per_second=1.0)
    for lease_s, count in ((0.0, 0), (30.0, 1)):
        steps = Ordering().steps(
            0.0,
            publishers=(),
            readers=[settled],
            plan=plan,
            reader_plans=plan_readers([settled], plan),
            reason="test",
            lease_s=lease_s,
        )
        assert [step.lease_s for step in steps.transitions] == [lease_s] * count


@pytest.mark.parametrize("terms", [{"min_rate_hz": 3.0}, {"weight": 2.0}, {"wire_bytes": 9e3}, {"packets": 7}])
def test_terms_alone_are_sent_too(terms):
    """No announcement shows the terms of the price, so new ones are sent until their generation is announced."""
    ordering = Ordering()
    settled = publisher("/n", TOPIC, generation=1, depth=20, deadline_ns=SHORT, rate_hz=5.0)

    def sent(generation, wanted):
        plan = QosPlan(generation=generation, topics={TOPIC: wanted}, level_bytes_per_second=1.0)
        known = replace(settled, generation=min(generation, announced))
        steps = ordering.steps(0.0, publishers=[known], readers=[], plan=plan, reader_plans={}, reason="")
        return [step.topics[TOPIC] for step in steps.transitions]

    announced, old, new = 1, row(SHORT), replace(row(SHORT), **terms)
    assert sent(1, old) == []
    assert sent(2, new) == [new]
    assert sent(2, new) == [new]
    announced = 2
    assert sent(2, new) == []
    assert sent(3, new) == []


def test_a_step_has_all_rows_of_its_node():
    """A node with something to do gets all of its rows, of publishers and readers; another one gets none."""
    done = publisher("/n", "/done", depth=20, deadline_ns=SHORT, rate_hz=5.0, generation=3)
    due = publisher("/n", "/due")
    heard = reader("/n", "/done", depth=20, generation=3)
    other = replace(done, node="/m", topic="/other")
    plan = QosPlan(
        generation=3, topics=dict.fromkeys(("/done", "/due", "/other"), row(SHORT)), level_bytes_per_second=1.0
    )
    ordering = Ordering()
    publishers, readers = (done, due, other), (heard,)
    steps = ordering.steps(
        0.0,
        publishers=publishers,
        readers=readers,
        plan=plan,
        reader_plans=plan_readers(readers, plan),
        reason="test",
    )
    assert [(step.node, sorted(step.topics), sorted(step.readers)) for step in steps.transitions] == [
        ("/n", ["/done", "/due"], []),
        ("/n", [], ["/done"]),
    ]


def test_a_plan_in_force_costs_nothing_until_something_changes():
    """While nothing arrives and nobody waits, the steps are the same object; a new announcement is looked at."""
    ordering = Ordering()
    plan = QosPlan(generation=3, topics={TOPIC: row(SHORT)}, level_bytes_per_second=1.0)
    publishers = (publisher("/n", TOPIC, depth=20, deadline_ns=SHORT, rate_hz=5.0, generation=3),)

    def steps(now_s, publishers, lease_s=0.0):
        return ordering.steps(
            now_s, publishers=publishers, readers=(), plan=plan, reader_plans={}, reason="test", lease_s=lease_s
        )

    first = steps(0.0, publishers)
    assert (first.transitions, first.confirmed) == ((), 1)
    assert steps(0.1, publishers) is first
    assert steps(0.2, publishers, lease_s=30.0).transitions
    assert steps(0.3, (replace(publishers[0], depth=10),)).transitions


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


def test_a_settled_publisher_that_changes_is_looked_at_again():
    """A depth set by hand, a lost lease and a new plan each make a step due again."""
    ordering = Ordering()
    plan = QosPlan(generation=3, topics={TOPIC: row(SHORT)}, level_bytes_per_second=1.0)
    settled = publisher("/n", TOPIC, depth=20, deadline_ns=SHORT, rate_hz=5.0, generation=3, lease_s=30.0)

    def is_asked(state, plan=plan):
        return bool(
            ordering.steps(
                0.0, publishers=(state,), readers=(), plan=plan, reader_plans={}, reason="test", lease_s=30.0
            ).transitions
        )

    for changed in ({"depth": 11}, {"lease_s": 0.0}, {"rate_hz": 9.0}, {"deadline_ns": 0}):
        assert not is_asked(settled)
        assert not is_asked(replace(settled, offered=5))
        assert is_asked(replace(settled, **changed)), changed
    assert not is_asked(settled)
    assert is_asked(settled, replace(plan, generation=4, topics={TOPIC: replace(row(SHORT), weight=3.0)}))
