"""Belief about the capacity: no amount of evidence makes it deaf, and none makes it nonsense."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.capacity import CapacityBelief

C = 1e6  # bytes/s


def stated(kind, parts, **about):
    """Return the capacity that is stated after evidence of parts of C, as a part, by one that was sure of C."""
    belief = CapacityBelief(C)
    for look, part in enumerate([1.0] * 6 + parts):
        belief.wait(0.1 * look)
        if look < 6:
            belief.train(C)
        kind(belief, part * C, **about)
    return belief.stated(math.inf) / C


@pytest.mark.parametrize(("part", "was_idle"), [(0.9, True), (0.6, False)])
def test_pings_show_by_and_by_how_busy_a_link_is(part, was_idle):
    """A link that carries nearly its capacity is hardly ever idle, and one that carries little is idle mostly."""
    seen = [stated(CapacityBelief.ping, [part] * times, was_idle=was_idle, weight=1.0) for times in (1, 3, 10)]
    assert seen == sorted(set(seen), reverse=not was_idle)


@pytest.mark.parametrize("kind", [CapacityBelief.delivered_busy, CapacityBelief.train])
def test_one_outlier_is_not_believed_and_two_are(kind):
    """A reading far from everything before is noise, until a second one agrees."""
    assert stated(kind, [5.0]) == pytest.approx(1.0, rel=0.25)
    assert stated(kind, [5.0, 5.0]) == pytest.approx(5.0, rel=0.1)


def test_new_evidence_outweighs_any_amount_of_old():
    """After minutes of the same readings, a link that changed is known as soon as after seconds."""
    belief = CapacityBelief(C)
    for look in range(5_003):
        belief.wait(0.1 * look)
        belief.delivered_busy(C if look < 5_000 else 0.2 * C)
    assert belief.stated(math.inf) == pytest.approx(0.2 * C, rel=0.1)


RATES = st.floats(1e-3, 1e15)
EVIDENCE = st.one_of(
    st.tuples(st.sampled_from(["delivered_busy", "carried", "train"]), RATES),
    st.tuples(st.just("ping"), RATES, st.booleans(), st.floats(0.0, 1.0)),
    st.tuples(st.just("wait"), st.floats(0.0, 1e4)),
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
