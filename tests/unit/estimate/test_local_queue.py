"""Queue of this host's own interface, and what leaves while it stands."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.local_queue import StandingQueue

RATE = 500_000.0  # bytes/s


@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.4), st.floats(0.02, 0.2)),  # link time that arrives s, until the next look s
        min_size=3,
        max_size=40,
    ),
    st.booleans(),
)
def test_a_link_that_never_idled_shows_its_exact_capacity(course, is_reported):
    """What waited before and had not all left is proof that the link never idled, so what left is the capacity."""
    queue, now_s, waiting = StandingQueue(), 100.0, 0.0
    for load_s, span_s in course:
        before, came = waiting, load_s * RATE
        # All of it comes at the end, so the link idles once the bytes of the last look have left.
        left = min(before, span_s * RATE)
        waiting = before - left + came
        now_s += span_s
        queue.note(now_s, waiting_bytes=waiting, left_bytes=left, interval_s=span_s if is_reported else None)
        if queue.busy_rate is not None:
            assert queue.busy_rate == pytest.approx(RATE)
        elif left > 0:
            assert before < 1.5 * left
    queue.clear()
    assert queue.busy_rate is None
