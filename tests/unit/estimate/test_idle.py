"""Idle links."""

from dataclasses import replace

import pytest

from arpd.estimate.idle import IdleLink
from tests.sample_link import INTERFACE, observation

CAPACITY = 1e6


def played(seconds, *, topics=0, bytes_per_second=0.0):
    """Return whether a link is idle after it was used like that."""
    link = IdleLink()
    for second in range(seconds):
        seen = replace(INTERFACE, rx_bytes=round(second * bytes_per_second))
        link.note(observation(float(second), counters=seen, sensing_topics=topics), moved=0.0, capacity=CAPACITY)
    return link.is_idle


@pytest.mark.parametrize(
    ("use", "is_idle"),
    [
        ({}, True),
        ({"bytes_per_second": 0.02 * CAPACITY}, True),
        ({"bytes_per_second": 0.2 * CAPACITY}, False),
        ({"topics": 1}, False),
    ],
)
def test_a_link_is_idle_without_topics_and_without_traffic(use, is_idle):
    """A topic that crosses, or much traffic of others, keeps a link from being idle; probes do not."""
    assert played(25, **use) is is_idle
