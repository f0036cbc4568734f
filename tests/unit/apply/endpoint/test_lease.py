"""The time for which a plan outlives its daemon."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.endpoint.lease import Lease
from arpd.model.plan import QosPlan, TopicPlan
from arpd.model.settings import OnLost, Settings
from tests.sample_publishers import plan_transitions, publisher

ROW = TopicPlan(rate_hz=10.0, min_rate_hz=1.0, deadline_ns=0, depth=20)
PLAN = QosPlan(generation=3, topics={"/a": ROW}, level_bytes_per_second=1e6)
CONFIRMED = publisher("/talker", "/a", rate_hz=ROW.rate_hz, depth=ROW.depth, generation=3)


@given(st.lists(st.floats(0.0, 100.0), min_size=1), st.floats(0.1, 100.0), st.floats(0.0, 200.0))
def test_it_is_over_when_the_last_sign_of_life_is_older_than_the_grant(signs, granted_s, now_s):
    """Only the newest sign counts, in any order of notes."""
    lease = Lease()
    lease.granted_s = granted_s
    for sign_s in signs:
        lease.renew(sign_s)
    assert lease.is_over(now_s) == (now_s - max(signs) > granted_s)


@pytest.mark.parametrize("now_s", [0.0, 1e9])
def test_without_a_grant_it_never_ends(now_s):
    """Without a grant the plan stays."""
    assert not Lease().is_over(now_s)


def test_only_the_choice_of_baseline_grants_a_lease():
    """`on_lost: keep` grants no lease."""
    settings = Settings(lost_after_s=12.0)
    assert settings.lease_s == 0.0
    assert replace(settings, on_lost=OnLost.BASELINE).lease_s == 12.0


def test_a_changed_lease_reaches_publishers_that_run_the_plan_already():
    """After a reload the nodes are sent the new lease with the same plan, until they announce it."""
    assert plan_transitions([CONFIRMED], PLAN, reason="test") == ()
    (transition,) = plan_transitions([CONFIRMED], PLAN, reason="test", lease_s=30.0)
    assert (transition.lease_s, transition.generation, transition.topics) == (30.0, 3, {"/a": ROW})
    announced = replace(CONFIRMED, lease_s=30.0)
    assert plan_transitions([announced], PLAN, reason="test", lease_s=30.0) == ()


def test_a_publisher_that_gave_the_plan_up_is_planned_for_again():
    """A returning daemon sees generation 0 with the application's QoS, and sends its plan."""
    lost = replace(CONFIRMED, generation=0, rate_hz=math.inf, depth=10, lease_s=30.0)
    (transition,) = plan_transitions([lost], PLAN, reason="test", lease_s=30.0)
    assert transition.topics == {"/a": ROW}
