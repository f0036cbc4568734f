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


def test_new_evidence_outweighs_any_amount_of_old():
    """After minutes of the same readings, a link that changed is known as soon as after seconds."""
    belief = CapacityBelief(C)
    for look in range(5_003):
        belief.wait(0.1 * look)
        belief.delivered_busy(C if look < 5_000 else 0.2 * C)
    assert belief.stated(math.inf) == pytest.approx(0.2 * C, rel=0.1)
