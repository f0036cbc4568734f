"""Classes of depth and deadline."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.classes import CLASSES, Fit, Move
from arpd.model.plan import TopicPlan

DEPTHS = st.integers(1, 5000)
FIT = Fit(period_ns=80_000_000, offered_ns=100_000_000, request_ns=0, depth=20, least_depth=1, most_depth=5000)


@given(DEPTHS, DEPTHS, DEPTHS)
def test_the_bounds_of_the_configuration_are_classes(depth, one, other):
    """A depth never falls below the least one because of a class, and the most one is taken exactly."""
    least, most = sorted((one, other))
    fit = FIT._replace(depth=min(depth, most), least_depth=least, most_depth=most)
    taken, _ = fit.qos(CLASSES)
    assert min(depth, least) <= taken <= min(depth, most)
    assert taken == most or depth < most


@pytest.mark.parametrize(
    ("fit", "depth", "deadline_ns", "move"),
    [
        (FIT, 8, 187_500_000, Move.TIGHTEN),
        (FIT, 8, 90_000_000, Move.RELAX),  # both ways: what promises too much comes first
        (FIT._replace(period_ns=0, offered_ns=0), 16, 187_500_000, Move.RELAX),
        (FIT._replace(period_ns=0, offered_ns=0), 16, 0, Move.NONE),
    ],
)
def test_a_row_moves_to_a_deeper_history_and_a_paused_one_to_no_deadline(fit, depth, deadline_ns, move):
    """A history that could be deeper is worth a move, and a rate of 0 keeps no deadline."""
    kept = TopicPlan(rate_hz=1.0, min_rate_hz=0.0, depth=depth, deadline_ns=deadline_ns)
    assert fit.move(kept, CLASSES) is move
