"""Classes of depth and deadline."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.govern.classes import CLASSES, Fit

DEPTHS = st.integers(1, 5000)


@given(DEPTHS, DEPTHS, DEPTHS)
def test_the_bounds_of_the_configuration_are_classes(depth, one, other):
    """A depth never falls below the least one because of a class, and the most one is taken exactly."""
    least, most = sorted((one, other))
    fit = Fit(
        period_ns=80_000_000,
        offered_ns=100_000_000,
        request_ns=0,
        depth=min(depth, most),
        least_depth=least,
        most_depth=most,
    )
    taken, _ = fit.qos(CLASSES)
    assert min(depth, least) <= taken <= min(depth, most)
    assert taken == most or depth < most
