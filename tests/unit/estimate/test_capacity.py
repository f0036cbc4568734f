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

BUSY, CARRIED, TRAIN = CapacityBelief.delivered_busy, CapacityBelief.carried, CapacityBelief.train


@pytest.mark.parametrize("part", [0.1, 0.5, 1.0, 2.0, 10.0])
@pytest.mark.parametrize(("kind", "times"), [(BUSY, 3), (CARRIED, 20), (TRAIN, 8)])
def test_every_kind_of_evidence_counts_and_what_was_carried_lowers_nothing(kind, times, part):
    """What a busy link delivers and what trains agree on counts both ways; what was carried is a lower bound."""
    stated = after(lambda belief: kind(belief, part * C), times)
    if kind is CARRIED:
        assert stated > 0.9 * max(1.0, part) * C
    else:
        assert stated == about(part * C)


@pytest.mark.parametrize(("part", "was_idle"), [(0.9, True), (0.6, False)])
def test_pings_show_by_and_by_how_busy_a_link_is(part, was_idle):
    """A link that carries nearly its capacity is hardly ever idle, and one that carries little is idle mostly."""

    def pinged(times, weight=1.0):
        return after(lambda belief: belief.ping(part * C, was_idle=was_idle, weight=weight), times)

    seen = [0.99 * C, pinged(1), pinged(3), pinged(10)] if was_idle else [pinged(10), pinged(3), pinged(1), C]
    assert seen == sorted(set(seen))
    assert abs(pinged(5, weight=0.2) / C - 1.0) < abs(pinged(5) / C - 1.0)


@pytest.mark.parametrize("part", [0.2, 0.5, 5.0])
@pytest.mark.parametrize("kind", [BUSY, TRAIN])
def test_one_outlier_is_not_believed_and_two_are(kind, part):
    """A reading far from everything before is noise, until a second one agrees; trains are more often too low."""
    assert after(lambda belief: kind(belief, part * C)) == pytest.approx(C, rel=0.25)
    assert (kind is TRAIN and part < 1.0) or after(lambda belief: kind(belief, part * C), times=2) == about(part * C)


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


# -- any evidence


RATES = st.floats(1e-3, 1e15)
EVIDENCE = st.one_of(
    st.tuples(st.sampled_from(["delivered_busy", "carried", "train"]), RATES),
    st.tuples(st.just("ping"), RATES, st.booleans(), st.floats(0.0, 1.0)),
    st.tuples(st.just("wait"), st.floats(0.0, 1e4)),
    st.tuples(st.just("scatter"), st.floats(0.0, 1.0)),
)


@given(RATES, st.lists(EVIDENCE, max_size=40))
def test_any_evidence_leaves_a_capacity(first, evidence):
    """At any evidence the belief divides by nothing, overflows nowhere, and states a capacity within its grid."""
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
            assert 400.0 < belief.stated(math.inf) < math.inf
