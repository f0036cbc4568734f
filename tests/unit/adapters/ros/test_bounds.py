"""Bounds of the values that parameters and plans may have."""

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.ros.bounds import (
    MOST_RATE_HZ,
    checked_floor_hz,
    checked_lease_s,
    checked_rate_hz,
    checked_weight,
    checked_wire_bytes,
)
from tests.examples import examples

BOUNDS = {
    checked_rate_hz: lambda value: 0 <= value <= MOST_RATE_HZ or value == math.inf,
    checked_floor_hz: lambda value: 0 <= value <= MOST_RATE_HZ,
    checked_lease_s: lambda value: value == 0 or 5 <= value <= 1e9,
    checked_weight: lambda value: value == 0 or 1e-6 <= value <= 1e6,
    checked_wire_bytes: lambda value: value == 0 or 1 <= value <= 1e12,
}


@pytest.mark.parametrize("check", BOUNDS, ids=lambda check: check.__name__)
@examples(60)
@given(value=st.floats())
def test_a_number_that_is_set_is_within_bounds_or_refused_by_name(check, value):
    """Any float, NaN and denormals too, is taken as it is or refused with a reason."""
    parameter = SimpleNamespace(name="arpd./t.publisher.x", value=value)
    if BOUNDS[check](value):
        assert check(parameter) == value
    else:
        with pytest.raises(ValueError, match=r"arpd\./t\.publisher\.x = .+ is"):
            check(parameter)
