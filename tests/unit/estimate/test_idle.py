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


def test_a_link_is_not_idle_at_the_start():
    """The first plans need the capacity at once."""
    assert not played(5)


def test_a_topic_ends_idleness_at_once():
    """With the first topic the capacity is wanted again."""
    link = IdleLink()
    for second in range(25):
        link.note(observation(float(second), sensing_topics=0), moved=0.0, capacity=CAPACITY)
    assert link.is_idle
    link.note(observation(25.1, sensing_topics=1), moved=0.0, capacity=CAPACITY)
    assert not link.is_idle


def test_a_link_rests_when_next_to_nothing_arrives():
    """Two seconds below 2 % of the capacity are a rest; more than that ends it at once."""
    link, rests = IdleLink(), []
    for second, delivered in enumerate([0.5, 0.01, 0.01, 0.01, 0.01, 0.03, 0.01]):
        link.note(observation(float(second)), moved=delivered * CAPACITY, capacity=CAPACITY)
        rests.append(link.is_resting)
    assert rests == [False, False, False, True, True, False, False]
