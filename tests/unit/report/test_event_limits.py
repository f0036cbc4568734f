"""Quotas and episodes keep the decision log from flooding."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from arpd.report.event_limits import Episode, Quota, Turn


def test_a_quota_lets_so_many_pass_in_a_minute_and_counts_the_rest():
    """Three pass and two count; a minute later the count is told, and another passes."""
    quota = Quota(3)
    assert [quota.take(float(at_s)) for at_s in range(5)] == [True, True, True, False, False]
    assert quota.settle(50.0) == 0
    assert quota.settle(64.0) == 2
    assert quota.settle(65.0) == 0
    assert quota.take(66.0)


def test_an_episode_is_told_when_it_begins_and_when_it_ends():
    """The end says how long it lasted."""
    episode = Episode()
    assert episode.look(0.0, holds=False) is None
    assert episode.look(1.0, holds=True) == Turn(holds=True)
    assert episode.look(2.0, holds=True) is None
    assert episode.look(11.5, holds=False) == Turn(holds=False, lasted_s=10.5)


def test_a_change_that_does_not_last_is_none():
    """With a hold time of two seconds, one second is not told; a longer change dates from its begin."""
    episode = Episode(hold_s=2.0)
    turns = [episode.look(at_s / 10, holds=10 <= at_s < 20 or at_s >= 50) for at_s in range(100)]
    told = [(at, turn) for at, turn in enumerate(turns) if turn is not None]
    assert [at for at, _ in told] == [70]
    assert episode.look(10.0, holds=False) is None
    assert episode.look(12.5, holds=False) == Turn(holds=False, lasted_s=5.0)


def test_flickering_is_told_three_times_and_then_once_a_minute_with_the_state_it_is_in():
    """On and off every half second: six turns, then one that counts, and the last turn is true."""
    episode = Episode()
    told = [(at_s, turn) for at_s in range(120) if (turn := episode.look(at_s / 2, holds=at_s % 2 == 0)) is not None]
    assert [turn.holds for _, turn in told] == [True, False] * 3
    later = [turn for at_s in range(120, 300) if (turn := episode.look(at_s / 2, holds=False)) is not None]
    assert [(turn.holds, turn.untold) for turn in later] == [(False, 57)]


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.booleans()), max_size=300))
def test_a_minute_has_few_turns_and_the_last_one_told_becomes_true(steps):
    """At any flicker at most eight turns fall into a minute; once it is calm, the last turn is true."""
    episode, now_s, told = Episode(), 0.0, []
    calm = [(0.1, steps[-1][1] if steps else False)] * 1300
    for step_s, holds in [*steps, *calm]:
        now_s += step_s
        if (turn := episode.look(now_s, holds=holds)) is not None:
            told.append((now_s, turn))
    for at_s, _ in told:
        assert sum(at_s <= other_s < at_s + 60.0 for other_s, _ in told) <= 8
    assert (told[-1][1].holds if told else False) == calm[-1][1]
