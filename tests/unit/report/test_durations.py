"""Durations: each counts once, in its bucket, and those of a snapshot never change."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.endpoints import SwapRecord
from arpd.report.durations import Distribution, Durations, SwapWatch
from tests.sample_publishers import publisher

BOUNDS = (0.01, 0.1, 1.0)


@given(st.lists(st.lists(st.floats(0.0, 10.0) | st.sampled_from(BOUNDS))))
def test_every_duration_counts_once(batches):
    """A bound counts all durations up to it, and the infinite one counts all."""
    empty = filled = Distribution.over(*BOUNDS)
    for batch in batches:
        filled = filled.including(batch)
    durations = [duration for batch in batches for duration in batch]
    assert filled.up_to == tuple(
        (bound, sum(duration <= bound for duration in durations)) for bound in (*BOUNDS, float("inf"))
    )
    assert filled.total_s == pytest.approx(sum(durations))
    assert empty == Distribution.over(*BOUNDS)


@pytest.mark.parametrize("bounds", [(), (1.0, 0.5), (1.0, 1.0)])
def test_bounds_ascend(bounds):
    """The constructor refuses bounds in another order."""
    with pytest.raises(ValueError, match="do not ascend"):
        Distribution.over(*bounds)


def swap(number, **seconds):
    return SwapRecord(number=number, result="ok", depth=10, deadline_ns=0, seconds_by_phase=seconds)


def seen(last_swap, topic="/a"):
    return publisher("/node", topic, last_swap=last_swap)


def test_a_swap_counts_when_it_has_finished_and_once():
    """Repeated announcements do not count again; a phase that was not entered has no duration."""
    watch = SwapWatch()
    assert watch.look([seen(None)]) == {}
    assert watch.look([seen(swap(1, matching=3.0, watching=0.2, holding=0.0))]) == {
        "matching": [3.0],
        "watching": [0.2],
    }
    assert watch.look([seen(swap(1, matching=3.0, watching=0.2, holding=0.0))]) == {}
    assert watch.look([seen(swap(2, matching=4.0)), seen(None, "/b")]) == {"matching": [4.0]}
    assert watch.look([seen(swap(2, matching=4.0)), seen(swap(1, matching=5.0), "/b")]) == {"matching": [5.0]}


def test_draining_counts_when_the_old_writer_is_gone():
    """It ends after the record of the swap, so the growth of the total counts."""

    def drained(seconds, number=1):
        return publisher(
            "/node", "/a", last_swap=swap(number, matching=3.0), swap_seconds_by_phase={"draining": seconds}
        )

    watch = SwapWatch()
    assert watch.look([drained(1.5)]) == {}  # before this daemon
    assert watch.look([drained(1.5, number=2)]) == {"matching": [3.0]}
    assert watch.look([drained(2.25, number=2)]) == {"draining": [0.75]}
    assert watch.look([drained(2.25, number=2)]) == {}
    assert watch.look([drained(0.0, number=1)]) == {"matching": [3.0]}  # started anew
    assert watch.look([drained(0.5, number=1)]) == {"draining": [0.5]}


def test_what_was_there_before_the_daemon_is_not_counted():
    """A swap in a publisher's first announcement may have finished under an earlier daemon."""
    watch = SwapWatch()
    assert watch.look([seen(swap(7, matching=3.0))]) == {}
    assert watch.look([seen(swap(8, matching=3.5))]) == {"matching": [3.5]}


def test_a_publisher_that_restarts_counts_from_its_first_swap_on():
    """Its numbers restart, with or without an announcement in between."""
    watch = SwapWatch()
    watch.look([seen(swap(7, matching=3.0))])
    assert watch.look([seen(swap(1, matching=3.1))]) == {"matching": [3.1]}
    watch.look([seen(None)])
    assert watch.look([seen(swap(1, matching=3.2))]) == {"matching": [3.2]}


def test_a_publisher_that_was_gone_is_first_seen_again():
    """Swaps in between have no known time and do not count; a publisher that is gone is forgotten."""
    watch = SwapWatch()
    watch.look([seen(swap(1, matching=3.0))])
    watch.look([])
    assert watch.look([seen(swap(2, matching=3.0))]) == {}
    watch.look([])
    assert not watch._last


def test_durations_of_a_snapshot_never_change():
    """A tick makes a new value; the old value stays."""
    before = Durations()
    after = before.with_ticks([0.004], late_s=[0.06], solve_s=0.0004, phases={"matching": [3.0, 3.1]})
    assert (before.ticks.up_to[-1][1], after.ticks.up_to[-1][1]) == (0, 1)
    assert after.lateness.total_s == 0.06
    assert after.solves.up_to[-1][1] == 1
    assert (before.swap_phases["matching"].up_to[-1][1], after.swap_phases["matching"].up_to[-1][1]) == (0, 2)
    assert after.with_ticks([0.004], late_s=[], solve_s=None, phases={}).solves is after.solves
