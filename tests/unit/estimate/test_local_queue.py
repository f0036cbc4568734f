"""Queue of this host's own interface, and what leaves while it stands."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.local_queue import LocalQueue, StandingQueue
from arpd.model.endpoints import Direction
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

    def blocked_rates(self, ticks=11, *, blocked_s=0.0, **looks):
        """Return the rates of all windows that end meanwhile; publishers wait for ``blocked_s`` of each tick."""
        rates = []
        for _ in range(ticks):
            self.look(**looks)
            self.blocked_s += blocked_s
            rates.append(self.blocked_rate())
        return [rate for rate in rates if rate is not None]


def test_a_queue_that_stands_is_as_long_as_it_takes_to_leave():
    """A queue seen at every look lasts as long as its bytes take to leave; one look shows no queue."""
    host = Host()
    assert host.look(100_000).backlog_s == 0.0
    queue = host.looks(4, 100_000)
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)
    assert queue.handed_bytes == host.sent + 100_000
    # At a standstill it is long, and not endless.
    assert 100_000 / RATE < host.looks(5, 100_000, rate=0.0).backlog_s < 100 * 100_000 / RATE


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**7), st.integers(0, 10**7)), min_size=3, max_size=30))
def test_a_queue_that_was_short_a_moment_ago_does_not_stand(peaks):
    """Messages that coincide are no queue, at any length for a moment."""
    host = Host()
    for first, second in peaks:
        host.look(first)
        host.look(second)
        assert host.look(round(BURST)).backlog_s == 0.0


@pytest.mark.parametrize("state", [InterfaceState.DOWN, InterfaceState.NO_CARRIER, None])
def test_an_interface_that_is_gone_has_no_queue(state):
    """Without an interface, or while it is down, there is no queue, and afterwards a queue must stand again."""
    host = Host()
    host.looks(5, 100_000)
    host.state = state or InterfaceState.UP
    queue = host.look(100_000, is_there=state is not None)
    assert (queue.backlog_s, queue.handed_bytes, queue.is_empty) == (0.0, None, False)
    assert (queue.busy_rate, queue.sent_bytes_per_second()) == (None, 0.0)
    host.state = InterfaceState.UP
    assert host.look(100_000).backlog_s == 0.0


def test_counters_that_restart_are_no_rate():
    """Looks before a restart of the interface are not compared with later ones."""
    host = Host()
    host.looks(5, 100_000)
    host.sent = 0
    queue = host.look(100_000)
    assert (queue.backlog_s, queue.busy_rate, queue.sent_bytes_per_second()) == (0.0, None, 0.0)
    queue = host.looks(4, 100_000)
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)
    assert queue.sent_bytes_per_second() == pytest.approx(RATE, rel=1e-3)


def test_what_left_lately_is_the_rate_of_sending():
    """The rate needs a third of a second to be known, and that long to follow."""
    host = Host()
    assert host.looks(2).sent_bytes_per_second() == 0.0
    assert host.looks(3).sent_bytes_per_second() == pytest.approx(RATE)
    assert host.looks(4, rate=2 * RATE).sent_bytes_per_second() == pytest.approx(2 * RATE)


def test_a_queue_is_empty_when_nothing_waits():
    """One look tells; where the kernel shows no backlog, there is neither an empty queue nor one that stands."""
    host = Host()
    queue = host.looks(5, None)
    assert (queue.is_empty, queue.backlog_s, queue.handed_bytes) == (False, 0.0, host.sent)
    assert host.look(0).is_empty
    assert not host.look(1).is_empty
    assert host.look(0).is_empty


# -- the conservation of bytes


@settings(deadline=None)
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


@pytest.mark.parametrize(
    ("waiting", "left", "span_s"),
    [(10_000, 10_000, 0.1), (100_000, 0, 0.1), (100_000, 1_000, 0.001)],
    ids=["idled", "nothing left", "too short"],
)
def test_without_proof_there_is_no_busy_rate(waiting, left, span_s):
    """When all that waited has left, nothing has, or too few packets were counted, the capacity is unknown."""
    queue = StandingQueue()
    queue.note(5.0, waiting_bytes=waiting, left_bytes=0)
    assert queue.busy_rate is None
    queue.note(5.0 + span_s, waiting_bytes=waiting, left_bytes=left)
    assert queue.busy_rate is None


def test_an_interval_that_began_before_the_last_look_proves_nothing():
    """What waited at a look need not have waited when a longer interval began."""
    queue = StandingQueue()
    queue.note(5.0, waiting_bytes=100_000, left_bytes=0)
    queue.note(5.001, waiting_bytes=99_500, left_bytes=50_000, interval_s=0.1)
    assert queue.busy_rate is None


# -- publishers that wait for room


def test_what_leaves_while_publishers_wait_is_the_rate():
    """Once per window, the rate shows when publishers waited for room for a good part of the time."""
    host = Host()
    assert host.blocked_rates(12) == []
    assert host.blocked_rates(10, blocked_s=0.05) == [pytest.approx(RATE, rel=1e-3)]
    assert host.blocked_rates(10, blocked_s=0.01) == []


def test_hole_5_a_dropped_packet_alone_shows_no_rate():
    """An idle link has bad moments."""
    host = Host()
    for _ in range(30):
        host.dropped += 1
        assert host.blocked_rates(1) == []


@pytest.mark.parametrize(
    ("changed", "blocked_s"),
    [({"node": "/m"}, 40.5), ({"direction": Direction.ACTUATION}, 40.5), ({}, 52.0), ({}, 0.0)],
    ids=["new", "on another host", "before", "gone"],
)
def test_waiting_of_another_time_or_place_is_none(changed, blocked_s):
    """A new publisher, one elsewhere or gone, and a wait longer than the window do not count."""
    host = Host()
    host.publisher = replace(PUBLISHER, direction=changed.get("direction", Direction.SENSING))
    host.blocked_s = 40.0
    host.blocked_rates(1)
    host.publisher = replace(PUBLISHER, **changed)
    host.blocked_s = blocked_s
    assert host.blocked_rates(10) == []


@pytest.mark.parametrize("mishap", ["gone", "restart", "outage"])
def test_a_window_with_a_mishap_in_it_is_none(mishap):
    """Bytes sent before an interface disappeared, restarted or slept are not compared with later ones."""
    host = Host()
    assert host.blocked_rates(6, blocked_s=0.05) == []
    if mishap == "restart":
        host.sent = 0
    host.now_s += 10.0 * (mishap == "outage")
    host.blocked_rates(1, is_there=mishap != "gone")
    assert host.blocked_rates(9, blocked_s=0.05) == []
    assert host.blocked_rates(4, blocked_s=0.05) == [pytest.approx(RATE, rel=1e-3)]


@settings(deadline=None)
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
