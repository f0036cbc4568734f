"""The rate schedule of a simulated link: its text form, its faults and its rates."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.adapters.sim.schedule import RateSchedule, RateStep

DROP_AND_RECOVERY = "0:20mbit,20:5mbit,50:20mbit"


def test_parses_the_documented_example():
    """The text becomes steps in bytes per second."""
    assert RateSchedule.parse(DROP_AND_RECOVERY).steps == (
        RateStep(start_s=0.0, rate_bytes_per_second=2_500_000.0),
        RateStep(start_s=20.0, rate_bytes_per_second=625_000.0),
        RateStep(start_s=50.0, rate_bytes_per_second=2_500_000.0),
    )


def test_order_and_spaces_do_not_matter():
    """Steps may come in any order, with spaces around them."""
    assert RateSchedule.parse(" 50:20mbit, 0:20mbit ,20:5mbit") == RateSchedule.parse(DROP_AND_RECOVERY)


@pytest.mark.parametrize(
    ("t_s", "mbit"), [(0.0, 20.0), (19.999, 20.0), (20.0, 5.0), (49.9, 5.0), (50.0, 20.0), (1e6, 20.0)]
)
def test_a_step_holds_from_its_start_until_the_next(t_s, mbit):
    """A step holds from its very start until the next one, and the last step never ends."""
    assert RateSchedule.parse(DROP_AND_RECOVERY).rate_at(t_s) == mbit * 125_000.0


def test_duration_is_the_start_of_the_last_step():
    """The duration is the start of the last step."""
    assert RateSchedule.parse(DROP_AND_RECOVERY).duration_s == 50.0
    assert RateSchedule.parse("0:20mbit").duration_s == 0.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "write SECONDS:RATE"),
        ("20mbit", "write SECONDS:RATE"),
        ("0:20mbit,", "write SECONDS:RATE"),
        ("soon:20mbit", "'soon' is not a number of seconds"),
        ("5:20mbit", "the first step must start at 0"),
        ("0:20mbit,-3:5mbit", "zero or later"),
        ("0:20mbit,nan:5mbit", "zero or later"),
        ("0:20mbit,7:5mbit,7:6mbit", "two steps start at 7 s"),
        ("0:20mbit,7:fast", "step '7:fast'"),
        ("0:20mbit,7:", "step '7:'"),
        ("0:20mbit,7:0mbit", "step '7:0mbit': the rate must be above zero; use loss 1 for an outage"),
    ],
)
def test_a_bad_schedule_is_refused_with_the_way_out(text, message):
    """The message names the step at fault."""
    with pytest.raises(ValueError, match=message):
        RateSchedule.parse(text)


def test_a_trace_may_stand_still():
    """A rate of zero is allowed outside the text form."""
    schedule = RateSchedule(steps=(RateStep(start_s=0.0, rate_bytes_per_second=0.0),))
    assert schedule.rate_at(5.0) == 0.0


@pytest.mark.parametrize("rate", [-1.0, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused(rate):
    """A rate must be finite and not negative."""
    with pytest.raises(ValueError, match="step at 1 s: the rate must be zero or more"):
        RateStep(start_s=1.0, rate_bytes_per_second=rate)


@pytest.mark.parametrize("t_s", [-0.001, math.nan])
def test_there_is_no_rate_before_the_start(t_s):
    """A time before the run raises an error."""
    with pytest.raises(ValueError, match="before the start"):
        RateSchedule.parse("0:20mbit").rate_at(t_s)


@given(
    st.dictionaries(st.integers(1, 1000), st.integers(1, 1000), max_size=8),
    st.integers(1, 1000),
    st.floats(0.0, 1100.0),
)
def test_the_rate_is_that_of_the_latest_step_begun(later, first, t_s):
    """At any time the rate is that of the last step that has started."""
    rates = {0: first, **later}
    schedule = RateSchedule.parse(",".join(f"{start}:{rate}mbit" for start, rate in rates.items()))
    expected = rates[max(start for start in rates if start <= t_s)]
    assert schedule.rate_at(t_s) == expected * 125_000.0
