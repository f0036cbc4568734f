"""How far a plan has come by what nodes tell."""

import math
from dataclasses import replace

import pytest

from arpd.govern.plan import is_confirmed, progress
from arpd.model.endpoints import RefusalReason
from arpd.model.plan import QosPlan, TopicPlan
from tests.sample_publishers import publisher

ROW = TopicPlan(rate_hz=math.inf, min_rate_hz=1.0, deadline_ns=0, depth=10, weight=2.0)
PLAN = QosPlan(generation=3, topics={"/a": ROW})


def test_a_node_that_forgot_its_plan_is_asked_again():
    """A publisher with the planned QoS that shows no plan, or another lease, lacks it; told times have six digits."""
    assert progress([publisher("/n", "/a", generation=0)], PLAN).missing == {"/n"}
    assert not progress([publisher("/n", "/a", generation=3)], PLAN).missing
    leased = publisher("/n", "/a", generation=3, lease_s=33.3333)
    assert progress([leased], PLAN, lease_s=0.0).missing == {"/n"}
    assert not progress([leased], PLAN, lease_s=100 / 3).missing


TARGET = TopicPlan(rate_hz=12.3456789, min_rate_hz=1.0, deadline_ns=5, depth=3)
SHOWN = publisher("/n", "/t", rate_hz=12.3457, depth=3, deadline_ns=5)  # told rates have six digits


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
