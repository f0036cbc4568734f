"""Bounds of the values that parameters and plans may have."""

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.ros.bounds import (
    LEAST_DEADLINE_NS,
    MOST_RATE_HZ,
    checked_deadline_ns,
    checked_depth,
    checked_floor_hz,
    checked_lease_s,
    checked_packets,
    checked_rate_hz,
    checked_weight,
    checked_wire_bytes,
)
from arpd.adapters.ros.grant import Grant
from arpd.model.plan import MOST_GENERATION

pytestmark = pytest.mark.ros

BOUNDS = {
    checked_rate_hz: lambda value: 0 <= value <= MOST_RATE_HZ or value == math.inf,
    checked_floor_hz: lambda value: 0 <= value <= MOST_RATE_HZ,
    checked_lease_s: lambda value: value == 0 or 5 <= value <= 1e9,
    checked_weight: lambda value: value == 0 or 1e-6 <= value <= 1e6,
    checked_wire_bytes: lambda value: value == 0 or 1 <= value <= 1e12,
}


@pytest.mark.parametrize("check", BOUNDS, ids=lambda check: check.__name__)
@settings(max_examples=60)
@given(value=st.floats())
def test_a_number_that_is_set_is_within_bounds_or_refused_by_name(check, value):
    """Any float, NaN and denormals too, is taken as it is or refused with a reason."""
    parameter = SimpleNamespace(name="arpd./t.publisher.x", value=value)
    if BOUNDS[check](value):
        assert check(parameter) == value
    else:
        with pytest.raises(ValueError, match=r"arpd\./t\.publisher\.x = .+ is"):
            check(parameter)


@settings(max_examples=60)
@given(st.integers(-(2**63), 2**63 - 1))
def test_an_integer_that_is_set_is_within_bounds_or_refused_by_name(value):
    """Depths from 1 to 5000 and deadlines from 10 us are taken, and the application's own deadline always."""
    parameter = SimpleNamespace(name="p", value=value)
    for check, is_good in (
        (lambda: checked_depth(parameter, 5000), 1 <= value <= 5000),
        (lambda: checked_deadline_ns(parameter), value == 0 or value >= LEAST_DEADLINE_NS),
        (lambda: checked_deadline_ns(parameter, own_ns=value), value >= 0),
        (lambda: checked_packets(parameter), 0 <= value <= 10**9),
    ):
        if is_good:
            assert check() in (value, 0)
        else:
            with pytest.raises(ValueError, match="p = "):
                check()


def test_no_plan_is_numbered_beyond_all_others():
    """A generation above the greatest is refused, because it would block every later plan."""
    tables = {name: {} for name in ("_parameters", "_descriptors", "_parameter_overrides")}
    declared = SimpleNamespace(has_parameter=lambda _name: False, **tables)
    grant = Grant(declared, generation_name="g", lease_name="l", plan="", whose="", clock=lambda: 0.0)
    grant.check([SimpleNamespace(name="g", value=MOST_GENERATION)])
    with pytest.raises(ValueError, match="g 9223372036854775807 is more than"):
        grant.check([SimpleNamespace(name="g", value=2**63 - 1)])
