"""Belief about the capacity: what pings show of it; the tests of the estimator have the other evidence."""

import math

import pytest

from arpd.estimate.capacity import CapacityBelief

C = 1e6  # bytes/s


@pytest.mark.parametrize(("part", "was_idle"), [(0.9, True), (0.6, False)])
def test_pings_show_by_and_by_how_busy_a_link_is(part, was_idle):
    """A link that carries nearly its capacity is hardly ever idle, and one that carries little is idle mostly."""
    stated = []
    for times in (1, 3, 10):
        belief = CapacityBelief(C)
        for look in range(6 + times):
            belief.wait(0.1 * look)
            if look < 6:
                belief.train(C)
            belief.ping(part * C if look >= 6 else C, was_idle=was_idle, weight=1.0)
        stated.append(belief.stated(math.inf))
    assert stated == sorted(set(stated), reverse=not was_idle)


@pytest.mark.parametrize(("part", "is_news"), [(2.0, True), (0.5, False)])
def test_what_arrives_shows_the_least_that_a_link_carries(part, is_news):
    """More than was believed possible raises the capacity, and less says nothing of it."""
    belief = CapacityBelief(C)
    for _ in range(5):
        belief.train(C)
    before = belief.stated(math.inf)
    for _ in range(5):
        belief.carried(part * C)
    assert (belief.stated(math.inf) > 1.5 * before) == is_news
    assert is_news or belief.stated(math.inf) == pytest.approx(before, rel=0.01)


def test_new_evidence_outweighs_any_amount_of_old():
    """After minutes of the same readings, a link that changed is known as soon as after seconds."""
    belief = CapacityBelief(C)
    for look in range(5_003):
        belief.wait(0.1 * look)
        belief.delivered_busy(C if look < 5_000 else 0.2 * C)
    assert belief.stated(math.inf) == pytest.approx(0.2 * C, rel=0.1)
