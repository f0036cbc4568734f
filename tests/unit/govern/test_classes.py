"""Classes of depth and deadline."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.classes import CLASSES, EXACT, LONGEST_DEADLINE_NS, Fit, Move, class_of_deadline, class_of_depth
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


@given(st.integers(1, LONGEST_DEADLINE_NS))
def test_a_deadline_goes_up_to_its_class(deadline_ns):
    """The class is at least as long, less than twice as long, and its own class."""
    period_ns = class_of_deadline(deadline_ns)
    assert deadline_ns <= period_ns <= LONGEST_DEADLINE_NS
    assert period_ns < max(2 * deadline_ns, 5_859_376)
    assert class_of_deadline(period_ns) == period_ns


@given(DEPTHS)
def test_a_depth_goes_down_to_its_class(depth):
    """The class is at most as deep, more than half as deep, and its own class."""
    samples = class_of_depth(depth)
    assert samples <= depth < 2 * samples
    assert class_of_depth(samples) == samples


@given(DEPTHS, DEPTHS, DEPTHS)
def test_the_bounds_of_the_configuration_are_classes(depth, one, other):
    """A depth never falls below the least one because of a class, and the most one is taken exactly."""
    least, most = sorted((one, other))
    taken, _ = fit(depth=min(depth, most), least=least, most=most).qos(CLASSES)
    assert min(depth, least) <= taken <= min(depth, most)
    assert taken == most or depth < most


@given(st.integers(1, 10**10))
def test_a_request_bounds_the_deadline_exactly(request_ns):
    """The offer is the class, or exactly what a reader requests."""
    assert fit(request_ns=request_ns).qos(CLASSES)[1] == min(request_ns, class_of_deadline(100_000_000))


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


def test_the_uniform_policy_is_exact():
    """Without classes depth and deadline are what the program gives."""
    assert fit().qos(EXACT) == (20, 100_000_000)
    assert fit(request_ns=40_000_000).qos(EXACT) == (20, 40_000_000)
