"""Plans from allocations."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.plan import Wanted
from arpd.model.allocation import Topic
from arpd.model.plan import QosPlan
from arpd.model.settings import Backend, DefaultPreferences, ProgramSettings, Settings
from arpd.solve.program import Program
from tests.examples import examples
from tests.sample_publishers import publisher

PUBLISHER = publisher("/n", "/t")
TOPIC = Topic(name="/t", wire_bytes=1200.0, packets=1, desired_rate_hz=20.0, min_rate_hz=2.0)
PROGRAM = Program(Settings(), backend=Backend.CLOSED_FORM)
EMPTY = QosPlan()


def planned(capacity, topics=(TOPIC,), publishers=(PUBLISHER,), *, previous=EMPTY, settings=None):
    allocation = PROGRAM.solve(PROGRAM.on_link(capacity, topics), 2.0**26)
    made = Wanted(allocation, topics, publishers, previous=previous.topics, settings=settings or Settings())
    return QosPlan(generation=previous.generation + 1, topics=made.rows)


@given(st.floats(1.0, 5.0), st.integers(1, 10**10), st.floats(5e3, 1e6), st.floats(0.5, 1000.0))
def test_the_offered_period_has_slack_and_stays_compatible(slack, requested_ns, capacity, source_hz):
    """The offer has the slack, 10 ms at least, is at most twice that, and is never longer than a reader requests."""
    slacked = Settings(program=ProgramSettings(deadline_slack=slack))
    topics = [replace(TOPIC, desired_rate_hz=source_hz, min_rate_hz=min(2.0, source_hz))]
    period_ns = PROGRAM.solve(PROGRAM.on_link(capacity, topics), 2.0**26).topics[0].deadline_ns
    free = planned(capacity, topics, settings=slacked).topics["/t"]
    slacked_ns = max(slack * period_ns, period_ns + 10_000_000)
    assert slacked_ns <= free.deadline_ns <= 2 * slacked_ns + 1
    reader = replace(PUBLISHER, requested_deadline_ns=requested_ns)
    made = planned(capacity, topics, publishers=[reader], settings=slacked).topics["/t"]
    assert made.deadline_ns == min(requested_ns, free.deadline_ns)


FOUR = [replace(TOPIC, name=f"/t{i}", wire_bytes=900.0 * (i + 1)) for i in range(4)]


def four(capacity, factor=1.0, previous=EMPTY):
    publishers = [replace(PUBLISHER, topic=topic.name) for topic in FOUR]
    return planned(capacity * factor, FOUR, publishers, previous=previous)


@examples(60)
@given(st.floats(1e4, 1e8), st.floats(0.92, 1.08))
def test_a_small_change_swaps_nothing_twice(capacity, factor):
    """A row that a small change moves into another class stays there when the change is undone, and when it returns."""
    changed = four(capacity, factor, previous=four(capacity))
    for again in (1.0, factor, 1.0):
        after = four(capacity, again, previous=changed)
        assert [row.qos for row in after.topics.values()] == [row.qos for row in changed.topics.values()]


@examples(60)
@given(st.floats(1e3, 1e8), st.floats(0.1, 10.0))
def test_whatever_was_in_force_rows_promise_no_more_than_the_program_gives(capacity, factor):
    """No period is shorter than that of the rate, and no history much deeper than the program allows."""
    after = four(capacity, factor, previous=four(capacity))
    answer = PROGRAM.solve(PROGRAM.on_link(capacity * factor, FOUR), 2.0**26)
    for given_, row in zip(answer.topics, after.topics.values(), strict=True):
        assert row.deadline_ns == 0 or 0 < given_.deadline_ns <= row.deadline_ns
        assert row.depth <= max(1.1 * given_.depth_applied, given_.depth_applied + 1)


SILENT = replace(PUBLISHER, source_rate_hz=0.0)
UNKNOWN = replace(TOPIC, desired_rate_hz=2.0, wire_bytes=1400.0)


@pytest.mark.parametrize(
    ("most_hz", "payload_bytes", "ceiling_hz"),
    [(None, 1e3, math.inf), (15.0, 1e3, 15.0), (None, 1e5, 1.25 * UNKNOWN.desired_rate_hz)],
)
def test_a_source_that_was_always_silent_has_no_basis_for_a_ceiling(most_hz, payload_bytes, ceiling_hz):
    """Where no rate is known, the operator's cap and the price bound small samples; large ones begin at the floor."""
    capped = Settings(defaults=DefaultPreferences(max_rate_hz=most_hz))
    silent = replace(SILENT, payload_bytes=payload_bytes)
    row = planned(1e6, [UNKNOWN], [silent], settings=capped).topics["/t"]
    assert (row.rate_hz, row.deadline_ns, row.wire_bytes) == (ceiling_hz, 0, UNKNOWN.wire_bytes)


@pytest.mark.parametrize("requested_ns", [50_000_000, 60_000_000, 62_000_000])
def test_a_class_never_costs_a_reader(requested_ns):
    """A row inside its class changes when any of its readers requests a shorter deadline than it offers."""
    first = planned(1e6)
    demanding = replace(PUBLISHER, requested_deadline_ns=requested_ns)
    lenient = replace(PUBLISHER, node="/lenient", requested_deadline_ns=70_000_000)
    for state in (demanding, replace(demanding, source_rate_hz=0.0)):
        second = planned(1e6, publishers=(lenient, state), previous=first)
        assert 0 < second.topics["/t"].deadline_ns <= requested_ns
