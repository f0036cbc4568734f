"""Classes of depth and deadline."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.classes import CLASSES, Fit, Move
from arpd.model.plan import TopicPlan

DEPTHS = st.integers(1, 5000)


def fit(offered_ns=100_000_000, depth=20, *, least=1, most=5000, request_ns=0):
    return Fit(
        period_ns=offered_ns * 4 // 5,
        offered_ns=offered_ns,
        request_ns=request_ns,
        depth=depth,
        least_depth=least,
        most_depth=most,
    )


def row(depth, deadline_ns):
    return TopicPlan(rate_hz=1.0, min_rate_hz=0.0, depth=depth, deadline_ns=deadline_ns)


@given(DEPTHS, DEPTHS, DEPTHS)
def test_the_bounds_of_the_configuration_are_classes(depth, one, other):
    """A depth never falls below the least one because of a class, and the most one is taken exactly."""
    least, most = sorted((one, other))
    taken, _ = fit(depth=min(depth, most), least=least, most=most).qos(CLASSES)
    assert min(depth, least) <= taken <= min(depth, most)
    assert taken == most or depth < most


@pytest.mark.parametrize(
    ("kept", "move"),
    [
        (row(16, 187_500_000), Move.NONE),
        (row(16, 92_000_000), Move.NONE),  # the slack has become less, but the rate keeps it
        (row(16, 90_000_000), Move.RELAX),
        (row(16, 0), Move.TIGHTEN),
        (row(16, 375_000_000), Move.TIGHTEN),
        (row(21, 187_500_000), Move.NONE),
        (row(23, 187_500_000), Move.RELAX),
        (row(8, 187_500_000), Move.TIGHTEN),
        (row(8, 90_000_000), Move.RELAX),  # both ways: what promises too much comes first
    ],
)
def test_a_row_moves_when_its_class_is_left_by_a_margin(kept, move):
    """A tenth beyond what the program gives, or one sample, stays; less is only asked for where a quarter is spare."""
    assert fit().move(kept, CLASSES) is move


def test_a_paused_topic_offers_no_deadline():
    """A rate of 0 keeps no deadline."""
    paused = fit()._replace(period_ns=0, offered_ns=0)
    assert paused.qos(CLASSES)[1] == 0
    assert paused.move(row(16, 187_500_000), CLASSES) is Move.RELAX
    assert paused.move(row(16, 0), CLASSES) is Move.NONE
