"""The rate schedule of a simulated link: its text form, its faults and its rates."""

import pytest

from arpd.sim.schedule import RateSchedule


def test_parses_the_documented_example():
    """Steps become bytes per second; they may come in any order, with spaces around them."""
    schedule = RateSchedule.parse(" 50:20mbit, 0:20mbit ,20:5mbit")
    assert [(step.start_s, step.rate_bytes_per_second) for step in schedule.steps] == [
        (0.0, 2_500_000.0),
        (20.0, 625_000.0),
        (50.0, 2_500_000.0),
    ]
    assert schedule.duration_s == 50.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "SECONDS:RATE"),
        ("soon:20mbit", "'soon'"),
        ("5:20mbit", "start at 0"),
        ("0:20mbit,-3:5mbit", "zero or later"),
        ("0:20mbit,7:5mbit,7:6mbit", "7 s"),
        ("0:20mbit,7:fast", "'7:fast'"),
    ],
)
def test_a_bad_schedule_is_refused_with_the_way_out(text, words):
    """The message names the step at fault."""
    with pytest.raises(ValueError, match=words):
        RateSchedule.parse(text)
