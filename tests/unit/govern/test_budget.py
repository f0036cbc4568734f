"""Budget of all topics: the estimate feeds it forward, the queue feeds it back."""

from dataclasses import replace

import pytest

from arpd.govern.budget import Budget
from arpd.model.allocation import Topic
from arpd.model.link import LinkState
from tests.sample_link import LINK

C = LINK.capacity_bytes_per_second


def allowed(**link):
    """Return the budget for one estimate."""
    return Budget().update(5.0, replace(LINK, **link), headroom=0.8)


def course(budget, *spans):
    """Update ten times a second, for spans of a duration (s) and a link."""
    now_s = 100.0
    for duration_s, link in spans:
        for _ in range(round(10 * duration_s)):
            now_s += 0.1
            budget.update(now_s, link, headroom=0.8)
    return budget


@pytest.mark.parametrize("which", ["standing", "long"])
def test_it_falls_with_the_queue_to_a_tenth(which):
    """The longer the queue, the less may follow, until it has drained; what costs little goes on beside any queue."""

    def with_queue(queue_s):
        if which == "standing":
            return allowed(standing_delay_s=queue_s)
        return allowed(queue_delay_s=LINK.queue_allowance_s + queue_s)

    budgets = [with_queue(0.01 * step) for step in range(100)]
    assert budgets[0] == pytest.approx(0.8 * C)
    assert budgets == sorted(budgets, reverse=True)
    assert any(0.0 < budget < 0.7 * C for budget in budgets)
    assert budgets[-1] == pytest.approx(0.1 * C)


@pytest.mark.parametrize(("floors", "goes_on"), [(0.02, 0.1), (0.14, 0.14), (0.9, 0.5)])
def test_floors_go_on_beside_any_queue(floors, goes_on):
    """What the floors need goes on, up to half of the link: a command must not stop for the queue of a picture."""
    command = Topic(name="/c", wire_bytes=0.01 * floors * C, packets=1, desired_rate_hz=200.0, min_rate_hz=100.0)
    queued = replace(LINK, standing_delay_s=0.5)
    assert Budget().update(5.0, queued, headroom=0.8, topics=[command]) == pytest.approx(goes_on * C)


# -- lasting


POOR = replace(LINK, capacity_bytes_per_second=0.25 * C)


@pytest.mark.parametrize(
    ("spans", "lasts"),
    [
        ([(40.0, LINK), (2.0, POOR)], C),
        ([(40.0, LINK), (4.0, POOR)], 0.25 * C),
        ([(40.0, POOR), (20.0, LINK)], 0.25 * C),
        ([(40.0, POOR), (31.0, LINK)], C),
        # A queue drains, and an outage is no capacity: none of them asks for other deadlines.
        ([(20.0, LINK), (10.0, replace(LINK, standing_delay_s=1.0)), (20.0, replace(LINK, state=LinkState.OUTAGE))], C),
    ],
    ids=["short fall", "fall", "short rise", "rise", "trouble"],
)
def test_what_nine_tenths_of_the_last_half_minute_allowed_lasts(spans, lasts):
    """A fall lasts after three seconds and a rise after half a minute; queues and outages are left out."""
    assert course(Budget(), *spans).lasting[0] == pytest.approx(lasts)


def test_what_packets_cost_beside_passing_traffic_does_not_last():
    """Cross traffic leaves less of the link, and so a packet costs more of the rest, but only while it lasts."""
    usual = replace(LINK, packet_overhead_s=1e-4)
    beside = replace(usual, cross_traffic_bytes_per_second=0.5 * C)
    assert beside.available_packet_overhead_s == pytest.approx(2e-4)
    assert course(Budget(), (20.0, usual), (2.0, beside)).lasting == pytest.approx((C, 1e-4))
    assert course(Budget(), (20.0, usual), (10.0, beside)).lasting == pytest.approx((0.5 * C, 2e-4))
