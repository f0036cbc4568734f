"""Plans from allocations, and steps from plans: safe at every interruption, and no step too many."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.apply.transitions import is_confirmed, restore_plan
from arpd.govern.plan import make_plan
from arpd.model.allocation import Topic
from arpd.model.endpoints import Direction, RefusalReason
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.settings import Backend, ProgramSettings, Settings, TopicSettings
from arpd.solve.program import Program
from tests.sample_publishers import plan_transitions, publisher

PUBLISHER = publisher("/n", "/t")
TOPIC = Topic(name="/t", wire_bytes=1200.0, packets=1, desired_rate_hz=20.0, min_rate_hz=2.0)
PROGRAM = Program(settings=ProgramSettings(backend=Backend.EXACT), headroom=0.85)
EMPTY = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)
PLANS = st.builds(
    TopicPlan,
    rate_hz=st.floats(0.0, 1000.0),
    min_rate_hz=st.just(0.0),
    deadline_ns=st.integers(0, 10**10),
    depth=st.integers(1, 5000),
)


def planned(capacity, topics=(TOPIC,), publishers=(PUBLISHER,), *, previous=EMPTY, settings=None):
    return make_plan(
        PROGRAM.solve(capacity, topics, 2.0**26),
        topics,
        publishers,
        previous=previous,
        generation=previous.generation + 1,
        settings=settings or Settings(),
    )


def plan(rows, generation=2):
    return QosPlan(generation=generation, topics=rows, level_bytes_per_second=1e6)


def applied(publishers, transition):
    """Return what the publishers announce after one step."""
    return [
        replace(p, rate_hz=r.rate_hz, depth=r.depth, deadline_ns=r.deadline_ns, generation=transition.generation)
        if p.node == transition.node and (r := transition.topics.get(p.topic))
        else p
        for p in publishers
    ]


def qos(row):
    """Return the fields of a row that the deadband keeps; a floor follows the link at no cost."""
    return row.rate_hz, row.depth, row.deadline_ns


def load(publishers):
    return sum(min(p.rate_hz, p.source_rate_hz) * p.payload_bytes for p in publishers)


@pytest.mark.parametrize("capacity", [1e5, 1e6, 1e8])
def test_a_topic_that_gets_all_it_wants_may_grow(capacity):
    """A topic at its desired rate is paced above its source, so jitter is not throttled."""
    assert planned(capacity).topics["/t"].rate_hz >= 1.1 * TOPIC.desired_rate_hz


def test_a_topic_the_link_holds_back_is_paced_at_its_share():
    """Where the link binds, the paced rate is the program's."""
    plan_row = planned(1e4).topics["/t"]
    assert plan_row.rate_hz == pytest.approx(0.85 * 1e4 / TOPIC.wire_bytes)


def test_an_operators_cap_is_a_cap():
    """The paced rate never exceeds `max_rate_hz`."""
    capped = Settings(default_topic=TopicSettings(max_rate_hz=15.0))
    topic = replace(TOPIC, desired_rate_hz=15.0)
    assert planned(1e8, [topic], settings=capped).topics["/t"].rate_hz == 15.0


@settings(deadline=None)
@given(st.floats(1.0, 5.0), st.integers(1, 10**10), st.floats(5e3, 1e6))
def test_the_offered_period_has_slack_and_stays_compatible(slack, requested_ns, capacity):
    """The offered period has the slack, and is never longer than a reader requests."""
    slacked = Settings(program=ProgramSettings(deadline_slack=slack))
    free = planned(capacity, settings=slacked).topics["/t"]
    reader = replace(PUBLISHER, requested_deadline_ns=requested_ns)
    made = planned(capacity, publishers=[reader], settings=slacked).topics["/t"]
    assert free.deadline_ns * min(free.rate_hz, TOPIC.desired_rate_hz) >= slack * 1e9 * (1 - 1e-9)
    assert made.deadline_ns == min(requested_ns, free.deadline_ns)


def test_a_paused_topic_offers_no_deadline():
    """A paused topic has rate, floor and deadline 0."""
    row = planned(0.0).topics["/t"]
    assert (row.rate_hz, row.min_rate_hz, row.deadline_ns) == (0.0, 0.0, 0)


@settings(deadline=None, max_examples=60)
@given(st.floats(1e4, 1e8), st.floats(0.9, 1.1))
def test_a_change_inside_the_deadband_swaps_nothing(capacity, factor):
    """A row keeps rate, depth and period when all three change less than the deadband."""
    topics = [replace(TOPIC, name=f"/t{i}", wire_bytes=900.0 * (i + 1)) for i in range(4)]
    publishers = [replace(PUBLISHER, topic=topic.name) for topic in topics]
    before = planned(capacity, topics, publishers)
    after = planned(capacity * factor, topics, publishers, previous=before)
    for name, kept in before.topics.items():
        fresh = after.topics[name]
        moved = [
            abs(getattr(fresh, field) - getattr(kept, field)) > 0.0999 * getattr(kept, field)
            for field in ("rate_hz", "depth", "deadline_ns")
        ]
        assert qos(fresh) == qos(kept) or any(moved)


ROBOTS = st.lists(
    st.builds(
        replace,
        st.just(TOPIC),
        wire_bytes=st.floats(100.0, 50_000.0),
        desired_rate_hz=st.floats(1.0, 300.0),
        min_rate_hz=st.floats(0.0, 300.0),
        weight=st.sampled_from([0.5, 1.0, 10.0]),
        latency_budget_s=st.sampled_from([None, 1.0]),
    ),
    min_size=1,
    max_size=6,
).map(
    lambda topics: [
        replace(topic, name=f"/t{i}", min_rate_hz=min(topic.min_rate_hz, topic.desired_rate_hz))
        for i, topic in enumerate(topics)
    ]
)


@settings(deadline=None, max_examples=60)
@given(ROBOTS, st.floats(1e3, 1e7), st.floats(1e3, 1e7))
def test_the_gate_can_always_take_away_half_of_the_plan(topics, capacity, later):
    """At any floors, a closed gate leaves at most half of the plan."""
    publishers = [replace(PUBLISHER, topic=topic.name) for topic in topics]
    made = EMPTY
    for now in (capacity, later):
        made = planned(now, topics, publishers, previous=made)
        given = PROGRAM.solve(now, topics, 2.0**26)
        spent = sum(row.share for row in given.topics)
        floors = sum(topic.wire_bytes * made.topics[topic.name].min_rate_hz / now for topic in topics)
        assert floors <= 0.5 * spent * (1 + 1e-6)
        assert all(0 <= row.min_rate_hz <= row.rate_hz for row in made.topics.values())


def test_floors_that_leave_room_are_what_the_operator_asked_for():
    """On a link with room floors stay as configured."""
    large = replace(TOPIC, name="/large", wire_bytes=20_000.0, desired_rate_hz=100.0)
    topics = [replace(TOPIC, min_rate_hz=10.0), large]
    publishers = [replace(PUBLISHER, topic=topic.name) for topic in topics]
    rows = planned(1e6, topics, publishers).topics
    assert rows["/t"].min_rate_hz >= 10.0
    assert rows["/large"].min_rate_hz == 2.0


def test_a_silent_source_keeps_its_row():
    """A silent source finds its QoS when it returns."""
    before = planned(1e6)
    silent = replace(PUBLISHER, source_rate_hz=0.0)
    after = planned(1e6, [replace(TOPIC, desired_rate_hz=2.0)], [silent], previous=before)
    assert qos(after.topics["/t"]) == qos(before.topics["/t"])


def test_the_tightest_request_of_all_readers_counts():
    """The shortest request of all readers decides."""
    publishers = [
        replace(PUBLISHER, node="/a", requested_deadline_ns=40_000_000),
        replace(PUBLISHER, node="/b", requested_deadline_ns=30_000_000),
        replace(PUBLISHER, node="/c"),
    ]
    assert planned(1e6, publishers=publishers).topics["/t"].deadline_ns == 30_000_000


def test_a_confirmed_publisher_needs_no_step():
    """A publisher that announces the plan gets no step; the announced rate has six digits."""
    target = TopicPlan(rate_hz=12.3456789, min_rate_hz=1.0, deadline_ns=5, depth=3)
    publisher = replace(PUBLISHER, rate_hz=12.3457, depth=3, deadline_ns=5)
    assert is_confirmed(publisher, target)
    assert plan_transitions([publisher], plan({"/t": target}), reason="") == ()
    assert not is_confirmed(replace(publisher, depth=4), target)


@pytest.mark.parametrize("reason", sorted(RefusalReason))
def test_only_a_refusal_for_good_settles_a_publisher(reason):
    """After a lasting refusal only a change of the rate causes a step; after a passing one, any difference does."""
    target = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=5, depth=3)
    slowed = replace(PUBLISHER, rate_hz=5.0, refusal="no", refusal_reason=reason)
    assert is_confirmed(slowed, target) == reason.is_lasting
    assert (plan_transitions([slowed], plan({"/t": target}), reason="") == ()) == reason.is_lasting
    assert not is_confirmed(replace(slowed, rate_hz=6.0), target)


def test_a_publisher_that_keeps_all_has_no_depth_to_confirm():
    """With a KEEP_ALL history, only rate and deadline count."""
    target = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=5, depth=3)
    everything = replace(PUBLISHER, rate_hz=5.0, deadline_ns=5, keeps_all=True)
    assert is_confirmed(everything, target)
    assert not is_confirmed(replace(everything, deadline_ns=6), target)


def test_topics_outside_the_plan_are_left_alone():
    """A topic without a row gets no step."""
    target = plan({"/t": TopicPlan(rate_hz=1.0, min_rate_hz=1.0, deadline_ns=5, depth=3)})
    assert plan_transitions([replace(PUBLISHER, topic="/other")], target, reason="") == ()


def test_a_topic_whose_far_reader_left_is_restored_too():
    """A clean stop restores the QoS of topics that no longer cross the link."""
    managed = replace(PUBLISHER, direction=Direction.LOCAL, rate_hz=5.0, depth=3, generation=7)
    (step,) = plan_transitions([managed], restore_plan([managed], generation=8), reason="stop")
    assert (step.topics["/t"].rate_hz, step.topics["/t"].depth) == (math.inf, 10)


@pytest.mark.parametrize("requested_ns", [50_000_000, 60_000_000, 62_000_000])
def test_the_deadband_never_costs_a_reader(requested_ns):
    """A row inside the deadband changes when a reader requests a shorter deadline than it offers."""
    first = planned(1e6)
    demanding = replace(PUBLISHER, requested_deadline_ns=requested_ns)
    for state in (demanding, replace(demanding, source_rate_hz=0.0)):
        second = planned(1e6, publishers=(state,), previous=first)
        assert 0 < second.topics["/t"].deadline_ns <= requested_ns


PUBLISHERS = st.lists(
    st.builds(
        replace,
        st.just(PUBLISHER),
        node=st.sampled_from(["/a", "/b", "/c", "/d"]),
        topic=st.sampled_from(["/t0", "/t1", "/t2"]),
        rate_hz=st.floats(0.0, 1000.0),
        source_rate_hz=st.floats(0.0, 1000.0),
        payload_bytes=st.floats(1.0, 1e5),
        depth=st.integers(1, 5000),
    ),
    max_size=10,
    unique_by=lambda publisher: (publisher.node, publisher.topic),
)


@settings(deadline=None)
@given(PUBLISHERS, st.dictionaries(st.sampled_from(["/t0", "/t1", "/t2"]), PLANS))
def test_every_prefix_of_the_steps_is_safe(publishers, rows):
    """After any number of steps each publisher has its old or new row, and the load never exceeds both ends."""
    target = plan(rows)
    steps = plan_transitions(publishers, target, reason="test")
    assert len({step.node for step in steps}) == len(steps)
    loads, now = [load(publishers)], publishers
    for step in steps:
        now = applied(now, step)
        loads.append(load(now))
        for old, new in zip(publishers, now, strict=True):
            assert new == old or is_confirmed(new, rows[new.topic])
    assert max(loads) <= max(loads[0], loads[-1]) * (1 + 1e-9) + 1e-6
    assert plan_transitions(now, target, reason="test") == ()


@settings(deadline=None)
@given(PUBLISHERS)
def test_restoring_gives_back_the_applications_qos(publishers):
    """After a clean stop every publisher has its baseline QoS, is unpaced, and needs no further step."""
    restored = restore_plan(publishers, generation=9)
    now = publishers
    for step in plan_transitions(publishers, restored, reason="stop"):
        now = applied(now, step)
    assert all((p.depth, p.deadline_ns, p.rate_hz) == (10, 0, math.inf) for p in now)
    assert plan_transitions(now, restored, reason="stop") == ()
