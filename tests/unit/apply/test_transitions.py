"""Steps towards a plan: safe at every interruption, and no step too many."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.transitions import is_confirmed, restore_plan
from arpd.model.endpoints import Direction, RefusalReason
from arpd.model.plan import QosPlan, TopicPlan
from tests.sample_publishers import plan_transitions, publisher

PUBLISHER = publisher("/n", "/t")


PLANS = st.builds(
    TopicPlan,
    rate_hz=st.floats(0.0, 1000.0),
    min_rate_hz=st.just(0.0),
    deadline_ns=st.integers(0, 10**10),
    depth=st.integers(1, 5000),
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


def test_a_confirmed_publisher_needs_no_step():
    """A publisher that announces the plan gets no step; the announced rate has six digits."""
    target = TopicPlan(rate_hz=12.3456789, min_rate_hz=1.0, deadline_ns=5, depth=3)
    publisher = replace(PUBLISHER, rate_hz=12.3457, depth=3, deadline_ns=5, generation=2)
    assert is_confirmed(publisher, target)
    assert plan_transitions([publisher], plan({"/t": target}), reason="") == ()
    assert not is_confirmed(replace(publisher, depth=4), target)


@pytest.mark.parametrize("reason", sorted(RefusalReason))
def test_only_a_refusal_for_good_settles_a_publisher(reason):
    """After a lasting refusal only a change of the ceiling causes a step; after a passing one, any difference does."""
    target = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=5, depth=3)
    slowed = replace(PUBLISHER, rate_hz=5.0, generation=2, refusal="no", refusal_reason=reason)
    assert is_confirmed(slowed, target) == reason.is_lasting
    assert (plan_transitions([slowed], plan({"/t": target}), reason="") == ()) == reason.is_lasting
    assert not is_confirmed(replace(slowed, rate_hz=6.0), target)


def test_a_publisher_that_keeps_all_has_no_depth_to_confirm():
    """With a KEEP_ALL history, only rate and deadline count."""
    target = TopicPlan(rate_hz=5.0, min_rate_hz=1.0, deadline_ns=5, depth=3)
    everything = replace(PUBLISHER, rate_hz=5.0, deadline_ns=5, keeps_all=True)
    assert is_confirmed(everything, target)
    assert not is_confirmed(replace(everything, deadline_ns=6), target)


def test_a_topic_whose_far_reader_left_is_restored_too():
    """A clean stop restores the QoS of topics that no longer cross the link."""
    managed = replace(PUBLISHER, direction=Direction.LOCAL, rate_hz=5.0, depth=3, generation=7)
    (step,) = plan_transitions([managed], restore_plan([managed], generation=8), reason="stop")
    assert (step.topics["/t"].rate_hz, step.topics["/t"].depth) == (math.inf, 10)


PUBLISHERS = st.lists(
    st.builds(
        replace,
        st.just(PUBLISHER),
        node=st.sampled_from(["/a", "/b", "/c", "/d"]),
        topic=st.sampled_from(["/t0", "/t1", "/t2"]),
        rate_hz=st.floats(0.0, 1000.0),
        depth=st.integers(1, 5000),
    ),
    max_size=10,
    unique_by=lambda publisher: (publisher.node, publisher.topic),
)


@given(PUBLISHERS, st.dictionaries(st.sampled_from(["/t0", "/t1", "/t2"]), PLANS))
def test_every_prefix_of_the_steps_is_safe(publishers, rows):
    """After any number of steps each publisher has its old or its new row."""
    target = plan(rows)
    steps = plan_transitions(publishers, target, reason="test")
    assert len({step.node for step in steps}) == len(steps)
    now = publishers
    for step in steps:
        now = applied(now, step)
        for old, new in zip(publishers, now, strict=True):
            assert new == old or is_confirmed(new, rows[new.topic])
    assert plan_transitions(now, target, reason="test") == ()


@given(PUBLISHERS)
def test_restoring_gives_back_the_applications_qos(publishers):
    """After a clean stop every publisher has its baseline QoS, is unpaced, and needs no further step."""
    restored = restore_plan(publishers, generation=9)
    now = publishers
    for step in plan_transitions(publishers, restored, reason="stop"):
        now = applied(now, step)
    assert all((p.depth, p.deadline_ns, p.rate_hz) == (10, 0, math.inf) for p in now)
    assert plan_transitions(now, restored, reason="stop") == ()
