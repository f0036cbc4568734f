"""Durations: each counts once, in its bucket, and those of a snapshot never change."""

from arpd.model.endpoints import SwapRecord
from arpd.report.durations import SwapWatch
from tests.sample_publishers import publisher


def swap(number, **seconds):
    return SwapRecord(number=number, result="ok", depth=10, deadline_ns=0, seconds_by_phase=seconds)


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
