"""Queue of this host's own interface, and what leaves while it stands."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.local_queue import LocalQueue
from arpd.model.endpoints import Direction
from arpd.model.interface import InterfaceState
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher

TICK_S = 0.1
WINDOW_S = 1.0
BURST = 15_000.0
RATE = 500_000.0  # bytes/s
PUBLISHER = publisher("/n", "/t")


class Host:
    """An interface that sends at `RATE`, read every 100 ms."""

    def __init__(self):
        self.queue = LocalQueue(WINDOW_S)
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

    def pushes_back(self):
        waiting = replace(self.publisher, blocked_s=self.blocked_s)
        return self.queue.pushes_back(observation(self.now_s, counters=self.counters, publishers=(waiting,)))

    def windows(self, ticks=11, **looks):
        """Return the results of all windows that end meanwhile."""
        out = []
        for _ in range(ticks):
            self.look(**looks)
            out.append(self.pushes_back())
        return [each for each in out if each is not None]


def test_a_queue_that_stands_is_as_long_as_it_takes_to_leave():
    """A queue seen at every look lasts as long as its bytes take to leave; one look shows no queue."""
    host = Host()
    assert not host.look(100_000).stands
    for _ in range(4):
        queue = host.look(100_000)
    assert queue.stands
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)
    assert queue.handed_bytes == host.sent + 100_000


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**7), st.integers(0, 10**7)), min_size=3, max_size=30))
def test_a_queue_that_was_short_a_moment_ago_does_not_stand(peaks):
    """Messages that coincide are no queue, at any length for a moment."""
    host = Host()
    for first, second in peaks:
        host.look(first)
        host.look(second)
        assert not host.look(round(BURST)).stands
        assert host.queue.backlog_s == 0.0


def test_without_a_known_backlog_there_is_no_queue():
    """Where the kernel shows no backlog, the bytes sent are the bytes handed over."""
    host = Host()
    for _ in range(5):
        queue = host.look(None)
    assert not queue.stands
    assert queue.handed_bytes == host.sent


def test_an_interface_that_sends_nothing_has_a_queue_of_finite_length():
    """At a standstill the bytes count at a small part of the capacity."""
    host = Host()
    for _ in range(5):
        queue = host.look(50_000, rate=0.0)
    assert queue.backlog_s == pytest.approx(50_000 / (0.05 * RATE))


@pytest.mark.parametrize("state", [InterfaceState.DOWN, InterfaceState.NO_CARRIER, None])
def test_an_interface_that_is_gone_has_no_queue(state):
    """Without an interface, or while it is down, there is no queue, and afterwards a queue must stand again."""
    host = Host()
    for _ in range(5):
        host.look(100_000)
    host.state = state or InterfaceState.UP
    queue = host.look(100_000, is_there=state is not None)
    assert (queue.stands, queue.backlog_s, queue.handed_bytes) == (False, 0.0, None)
    host.state = InterfaceState.UP
    assert not host.look(100_000).stands


def test_counters_that_restart_are_no_rate():
    """Looks before a restart of the interface are not compared with later ones."""
    host = Host()
    for _ in range(5):
        host.look(100_000)
    host.sent = 0
    assert not host.look(100_000).stands
    for _ in range(4):
        queue = host.look(100_000)
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)


# -- windows


def test_nothing_pushes_back_on_an_interface_that_keeps_up():
    """Once per window the result has the rate, and that the interface kept up."""
    host = Host()
    host.windows(1)
    ((pushes_back, sent),) = host.windows(10)
    assert not pushes_back
    assert sent == pytest.approx(RATE, rel=1e-3)


@pytest.mark.parametrize("how", ["queue", "dropped", "blocked"])
def test_an_interface_that_cannot_keep_up_shows_its_rate(how):
    """A standing queue, a dropped packet, or waiting publishers show that the rate is the limit."""
    host = Host()
    host.windows(1)
    host.dropped += how == "dropped"
    host.blocked_s += 0.5 * (how == "blocked")
    ((pushes_back, sent),) = host.windows(10, backlog=100_000 if how == "queue" else 0)
    assert pushes_back
    assert sent == pytest.approx(RATE, rel=1e-3)


def test_a_publisher_that_leaves_takes_its_waiting_along():
    """A waiting time that falls is no waiting."""
    host = Host()
    host.blocked_s = 40.0
    host.windows(1)
    host.blocked_s = 0.0
    ((pushes_back, _),) = host.windows(10)
    assert not pushes_back


@pytest.mark.parametrize("other", [{"node": "/m"}, {"direction": Direction.ACTUATION}, {}])
def test_waiting_of_another_time_or_place_is_none(other):
    """A new publisher, one on another host, and a wait longer than the window do not count."""
    host = Host()
    host.publisher = replace(PUBLISHER, direction=other.get("direction", Direction.SENSING))
    host.windows(1)
    host.publisher = replace(PUBLISHER, **other)
    host.blocked_s += 0.5 if other else 12.0
    ((pushes_back, _),) = host.windows(10)
    assert not pushes_back


@pytest.mark.parametrize("mishap", ["gone", "restart"])
def test_a_window_with_a_mishap_in_it_is_none(mishap):
    """Bytes sent before an interface disappeared or restarted are not compared with later ones."""
    host = Host()
    assert len(host.windows(6)) == 0
    if mishap == "restart":
        host.sent = host.dropped = 0
    host.windows(1, is_there=mishap == "restart")
    assert host.windows(9) == []
    ((pushes_back, sent),) = host.windows(4)
    assert not pushes_back
    assert sent == pytest.approx(RATE, rel=1e-3)


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
        assert 0.0 <= queue.backlog_s < float("inf")
        window = host.pushes_back()
        assert window is None or 0.0 <= window[1] < float("inf")


def test_a_window_with_an_outage_in_it_is_none():
    """Bytes that left before an outage are not averaged over the time of the outage."""
    host = Host()
    host.windows(3)
    host.now_s += 10.0
    host.dropped += 1
    for pushes_back, sent in host.windows(12):
        assert not pushes_back
        assert sent == pytest.approx(RATE, rel=1e-3)
