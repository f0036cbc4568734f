"""Belief about the capacity: each kind of evidence errs to its own side, and none makes it nonsense."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.capacity import CapacityBelief

C = 1e6  # bytes/s


def sure(capacity=C):
    """Return a belief that is sure of a capacity, at the time 0."""
    belief = CapacityBelief(capacity)
    belief.wait(0.0)
    for _ in range(6):
        belief.train(capacity)
        belief.delivered_busy(capacity)
    return belief


def after(evidence, times=1):
    """Return the capacity that is stated after the same evidence in some looks, for one that was sure of C."""
    belief = sure()
    for look in range(1, times + 1):
        belief.wait(0.1 * look)
        evidence(belief)
    return belief.stated(math.inf)


def about(capacity):
    return pytest.approx(capacity, rel=0.1)


# -- to which side each kind errs


@pytest.mark.parametrize("part", [0.1, 0.5, 1.0, 2.0, 10.0])
def test_a_busy_link_delivers_its_capacity(part):
    """What a busy link delivers counts in both directions."""
    assert after(lambda belief: belief.delivered_busy(part * C), times=3) == about(part * C)


@pytest.mark.parametrize("part", [0.01, 0.5, 0.9])
def test_what_was_carried_lowers_nothing(part):
    """A link that carried little may carry more."""
    assert after(lambda belief: belief.carried(part * C), times=20) > 0.9 * C


@pytest.mark.parametrize("part", [1.5, 10.0])
def test_what_was_carried_is_a_lower_bound(part):
    """A link that carried more than was believed carries at least that."""
    assert after(lambda belief: belief.carried(part * C), times=5) > 0.95 * part * C


@pytest.mark.parametrize("part", [1.5, 10.0])
def test_trains_that_see_more_are_right(part):
    """Two trains that agree on much more are believed."""
    assert after(lambda belief: belief.train(part * C), times=2) == about(part * C)


@pytest.mark.parametrize("part", [0.2, 0.5])
def test_trains_that_see_less_may_be_wrong(part):
    """One train that reads low lowers little, and many that agree lower to what they see."""
    assert after(lambda belief: belief.train(part * C)) > 0.9 * C
    assert after(lambda belief: belief.train(part * C), times=8) == about(part * C)


@pytest.mark.parametrize(("part", "was_idle"), [(0.9, True), (0.6, False)])
def test_pings_show_by_and_by_how_busy_a_link_is(part, was_idle):
    """A link that carries nearly its capacity is hardly ever idle, and one that carries little is idle mostly."""

    def pinged(times, weight=1.0):
        return after(lambda belief: belief.ping(part * C, was_idle=was_idle, weight=weight), times)

    seen = [0.99 * C, pinged(1), pinged(3), pinged(10)] if was_idle else [pinged(10), pinged(3), pinged(1), C]
    assert seen == sorted(set(seen))
    assert abs(pinged(5, weight=0.2) / C - 1.0) < abs(pinged(5) / C - 1.0)


@pytest.mark.parametrize("part", [0.2, 5.0])
@pytest.mark.parametrize("kind", [CapacityBelief.delivered_busy, CapacityBelief.train])
def test_one_outlier_is_not_believed_and_two_are(kind, part):
    """A reading far from everything before is noise, until a second one agrees."""
    assert after(lambda belief: kind(belief, part * C)) == pytest.approx(C, rel=0.25)
    times = 2 if kind is CapacityBelief.delivered_busy or part > 1.0 else 8
    assert after(lambda belief: kind(belief, part * C), times) == about(part * C)


def test_new_evidence_outweighs_any_amount_of_old():
    """After hours of the same readings, a link that changed is known as soon as after seconds."""
    belief = sure()
    for look in range(5_000):
        belief.wait(0.1 * look)
        belief.delivered_busy(C)
    for look in range(3):
        belief.wait(500.0 + 0.1 * look)
        belief.delivered_busy(0.2 * C)
    assert belief.stated(math.inf) == about(0.2 * C)


# -- time


def doubt(belief):
    """Return the distance of a high and a low quantile, of the logarithm."""
    return math.log(belief._quantile(0.9) / belief._quantile(0.1))


def test_time_makes_it_less_sure():
    """Without evidence the link may have drifted or jumped, so doubt grows, and the capacity stays for a while."""
    belief = sure()
    doubts = []
    for tenths in range(1, 100):
        belief.wait(0.1 * tenths)
        doubts.append(doubt(belief))
        assert tenths > 10 or belief.stated(math.inf) == about(C)
    assert doubts == sorted(doubts)


def test_a_jump_makes_it_less_sure_at_once():
    """After an outage the link may be another one."""
    belief = sure()
    before = doubt(belief)
    belief.scatter(0.7)
    assert doubt(belief) > 2.0 * before
    belief.train(5.0 * C)
    belief.train(5.0 * C)
    assert belief.stated(math.inf) == about(5.0 * C)


# -- any evidence


RATES = st.floats(1e-3, 1e15)
EVIDENCE = st.one_of(
    st.tuples(st.sampled_from(["delivered_busy", "carried", "train"]), RATES),
    st.tuples(st.just("ping"), RATES, st.booleans(), st.floats(0.0, 1.0)),
    st.tuples(st.just("wait"), st.floats(0.0, 1e4)),
    st.tuples(st.just("scatter"), st.floats(0.0, 1.0)),
)


@given(RATES, st.lists(EVIDENCE, max_size=40))
def test_any_evidence_leaves_probabilities(first, evidence):
    """At any evidence the probabilities are finite, positive and sum to one, and quantiles ascend within the grid."""
    now_s = 0.0
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        belief = CapacityBelief(first)
        for kind, *values in evidence:
            match kind, values:
                case "wait", (elapsed_s,):
                    now_s += elapsed_s
                    belief.wait(now_s)
                case "ping", (rate, was_idle, weight):
                    belief.ping(rate, was_idle=was_idle, weight=weight)
                case _, (value,):
                    getattr(belief, kind)(value)
            assert belief._p.sum() == pytest.approx(1.0, abs=1e-6)
            assert np.isfinite(belief._p).all()
            assert (belief._p > 0.0).all()
            quantiles = [belief._quantile(part) for part in (0.0, 0.05, 0.3, 0.45, 0.5, 0.95, 1.0)]
            assert quantiles == sorted(quantiles)
            assert 400.0 < quantiles[0] <= belief.stated(math.inf) <= quantiles[-1] < math.inf
