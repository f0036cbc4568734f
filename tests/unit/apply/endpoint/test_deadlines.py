"""Deadlines missed over several endpoints, of which one at a time is in force."""

from hypothesis import given
from hypothesis import strategies as st

from arpd.apply.endpoint.meters import DeadlineCount


class Endpoint:
    def __init__(self):
        self.missed = 0

    def deadlines_missed(self):
        return self.missed


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 5), st.booleans()), max_size=30))
def test_what_counts_is_what_the_endpoint_in_force_misses(steps):
    """Whatever the others count before, meanwhile and afterwards, and however often each takes its turn."""
    endpoints = [Endpoint() for _ in range(3)]
    count, in_force, expected = DeadlineCount(endpoints[0]), 0, 0
    for which, missed, takes_over in steps:
        endpoints[which].missed += missed
        expected += missed if which == in_force else 0
        if takes_over:
            count.follow(endpoints[which])
            in_force = which
        assert count.missed == expected
