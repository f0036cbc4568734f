"""Rate of samples, and missed deadlines over several endpoints."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.endpoint.meters import DeadlineCount, SampleRate


def test_what_waited_for_a_caller_that_was_held_up_is_no_rate():
    """After a stall the queued samples come at once; the rate is that of the samples that follow."""
    rate, now_s = SampleRate(), 100.0
    for _ in range(100):
        now_s += 0.001
        rate.count(now_s)
    for _ in range(20):
        now_s += 0.05
        rate.count(now_s)
    assert rate.rate_hz(now_s) == pytest.approx(20.0, rel=0.02)


class Endpoint:
    def __init__(self):
        self.missed = 0

    def deadlines_missed(self):
        return self.missed


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 5), st.booleans()), max_size=30))
def test_what_counts_is_what_the_endpoint_in_force_misses(steps):
    """Only the misses of the endpoint in force count, however often endpoints replace each other."""
    endpoints = [Endpoint() for _ in range(3)]
    count, in_force, expected = DeadlineCount(endpoints[0]), 0, 0
    for which, missed, takes_over in steps:
        endpoints[which].missed += missed
        expected += missed if which == in_force else 0
        if takes_over:
            count.follow(endpoints[which])
            in_force = which
        assert count.missed == expected
