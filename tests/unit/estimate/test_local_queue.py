"""Queue of this host's own interface, and what leaves while it stands."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.local_queue import LocalQueue, StandingQueue
from arpd.model.interface import InterfaceState
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher

TICK_S = 0.1
BURST = 15_000.0
RATE = 500_000.0  # bytes/s
PUBLISHER = publisher("/n", "/t")


class Host:
    """An interface that sends at `RATE`, read every 100 ms."""

    def __init__(self):
        self.queue = LocalQueue()
        self.now_s = 300.0
        self.sent = 5_000_000
        self.dropped = 0
        self.blocked_s = 0.0
        self.publisher = PUBLISHER
        self.state = InterfaceState.UP

    def look(self, backlog=0, *, rate=RATE, after_s=TICK_S, is_there=True):
        self.now_s += after_s
        self.sent += round(rate * after_s)
        counters = replace(
            INTERFACE, tx_bytes=self.sent, tx_dropped=self.dropped, state=self.state, backlog_bytes=backlog
        )
        self.counters = counters if is_there else None
        self.queue.update(self.counters, self.now_s, burst_bytes=BURST, capacity=RATE)
        return self.queue

    def looks(self, count, *args, **kwargs):
        for _ in range(count):
            queue = self.look(*args, **kwargs)
        return queue

    def blocked_rate(self):
        waiting = replace(self.publisher, blocked_s=self.blocked_s)
        return self.queue.blocked_rate(observation(self.now_s, counters=self.counters, publishers=(waiting,)))


def test_a_queue_that_stands_is_as_long_as_it_takes_to_leave():
    """A queue seen at every look lasts as long as its bytes take to leave; one look shows no queue."""
    host = Host()
    assert host.look(100_000).backlog_s == 0.0
    queue = host.looks(4, 100_000)
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)
    assert queue.handed_bytes == host.sent + 100_000
    # At a standstill it is long, and not endless.
    assert 100_000 / RATE < host.looks(5, 100_000, rate=0.0).backlog_s < 100 * 100_000 / RATE


# -- the conservation of bytes


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


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "backlog": st.one_of(st.none(), st.integers(0, 10**7)),
                "rate": st.floats(-1e8, 1e8),
                "after_s": st.floats(0.0, 2.0),
                "is_there": st.booleans(),
            }
        ),
        max_size=60,
    )
)
def test_any_counters_give_a_length_and_a_rate(looks):
    """Counters that fall, stand still, vanish or are read twice at once give no exception and nothing negative."""
    host = Host()
    for look in looks:
        host.sent = max(0, host.sent)
        queue = host.look(**look)
        host.blocked_s += 0.05
        assert 0.0 <= queue.backlog_s < float("inf")
        assert 0.0 <= queue.sent_bytes_per_second() < float("inf")
        for rate in (queue.busy_rate, host.blocked_rate()):
            assert rate is None or 0.0 < rate < float("inf")
