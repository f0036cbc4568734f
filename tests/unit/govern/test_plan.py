"""Plans from allocations."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.govern.plan import make_plan
from arpd.model.allocation import Topic
from arpd.model.plan import QosPlan
from arpd.model.settings import Backend, ProgramSettings, Settings, TopicSettings
from arpd.solve.program import Program
from tests.sample_publishers import publisher

PUBLISHER = publisher("/n", "/t")
TOPIC = Topic(name="/t", wire_bytes=1200.0, packets=1, desired_rate_hz=20.0, min_rate_hz=2.0)
PROGRAM = Program(settings=ProgramSettings(backend=Backend.EXACT), headroom=0.85)
EMPTY = QosPlan(generation=0, topics={}, level_bytes_per_second=0.0)


def planned(capacity, topics=(TOPIC,), publishers=(PUBLISHER,), *, previous=EMPTY, settings=None):
    return make_plan(
        PROGRAM.solve(capacity, topics, 2.0**26),
        topics,
        publishers,
        previous=previous,
        generation=previous.generation + 1,
        settings=settings or Settings(),
    )


def qos(row):
    """Return the fields of a row that the deadband keeps; a floor follows the link at no cost."""
    return row.rate_hz, row.depth, row.deadline_ns


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


@pytest.mark.parametrize("requested_ns", [50_000_000, 60_000_000, 62_000_000])
def test_the_deadband_never_costs_a_reader(requested_ns):
    """A row inside the deadband changes when a reader requests a shorter deadline than it offers."""
    first = planned(1e6)
    demanding = replace(PUBLISHER, requested_deadline_ns=requested_ns)
    for state in (demanding, replace(demanding, source_rate_hz=0.0)):
        second = planned(1e6, publishers=(state,), previous=first)
        assert 0 < second.topics["/t"].deadline_ns <= requested_ns
