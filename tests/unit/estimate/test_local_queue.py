"""What this host sees of its own interface: a queue that stands, and what leaves while it does."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.local_queue import LocalQueue
from arpd.model.endpoints import Direction, PublisherState
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.observation import MemoryState, Observation

TICK_S = 0.1
WINDOW_S = 1.0
BURST = 15_000.0
RATE = 500_000.0  # bytes/s
PUBLISHER = PublisherState(
    node="/n",
    topic="/t",
    type_name="t",
    direction=Direction.SENSING,
    payload_bytes=100.0,
    source_rate_hz=10.0,
    published=0,
    depth=1,
    baseline_depth=1,
    remote_readers=1,
)


class Host:
    """An interface that sends `RATE`, looked at every 100 ms."""

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
        counters = LinkCounters(
            interface="w",
            rx_bytes=0,
            tx_bytes=self.sent,
            rx_packets=0,
            tx_packets=0,
            tx_dropped=self.dropped,
            state=self.state,
            backlog_bytes=backlog,
        )
        self.counters = counters if is_there else None
        self.queue.update(self.counters, self.now_s, burst_bytes=BURST, capacity=RATE)
        return self.queue

    def pushes_back(self):
        return self.queue.pushes_back(
            Observation(
                now_s=self.now_s,
                counters=self.counters,
                reports=(),
                publishers=(replace(self.publisher, blocked_s=self.blocked_s),),
                memory=MemoryState(total_bytes=1, available_bytes=1),
                sensing_topics=0,
                actuation_topics=0,
            )
        )

    def told(self, ticks=11, **looks):
        """Return what is told in a while, nothing left out."""
        out = []
        for _ in range(ticks):
            self.look(**looks)
            out.append(self.pushes_back())
        return [each for each in out if each is not None]


def test_a_queue_that_stands_is_as_long_as_it_takes_to_leave():
    """Seen at look after look, its bytes count at the rate at which they leave."""
    host = Host()
    for _ in range(5):
        queue = host.look(100_000)
    assert queue.stands
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)
    assert queue.handed_bytes == host.sent + 100_000


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**7), st.integers(0, 10**7)), min_size=3, max_size=30))
def test_a_queue_that_was_short_a_moment_ago_does_not_stand(peaks):
    """Messages that meet are no queue, however long it is for a moment."""
    host = Host()
    for first, second in peaks:
        host.look(first)
        host.look(second)
        assert not host.look(round(BURST)).stands
        assert host.queue.backlog_s == 0.0


def test_one_look_is_no_queue():
    """A queue seen once says nothing of how it was a moment before."""
    host = Host()
    assert not host.look(10**6).stands


def test_a_kernel_that_tells_no_backlog_shows_no_queue():
    """Where there is no qdisc to ask, what was sent is what was handed over."""
    host = Host()
    for _ in range(5):
        queue = host.look(None)
    assert not queue.stands
    assert queue.handed_bytes == host.sent


def test_an_interface_that_sends_nothing_has_a_queue_of_finite_length():
    """At a standstill the time is that at a small part of the capacity."""
    host = Host()
    for _ in range(5):
        queue = host.look(50_000, rate=0.0)
    assert queue.backlog_s == pytest.approx(50_000 / (0.05 * RATE))


@pytest.mark.parametrize("state", [InterfaceState.DOWN, InterfaceState.NO_CARRIER, None])
def test_an_interface_that_is_gone_has_no_queue(state):
    """Gone, down or without a carrier it tells nothing, and afterwards a queue must stand anew."""
    host = Host()
    for _ in range(5):
        host.look(100_000)
    host.state = state or InterfaceState.UP
    queue = host.look(100_000, is_there=state is not None)
    assert (queue.stands, queue.backlog_s, queue.handed_bytes) == (False, 0.0, None)
    host.state = InterfaceState.UP
    assert not host.look(100_000).stands


def test_counters_that_start_anew_are_no_rate():
    """An interface made anew counts from zero: no look before that is compared with one after it."""
    host = Host()
    for _ in range(5):
        host.look(100_000)
    host.sent = 0
    assert not host.look(100_000).stands
    for _ in range(4):
        queue = host.look(100_000)
    assert queue.backlog_s == pytest.approx(100_000 / RATE, rel=1e-3)


# -- what a host learns alone


def test_nothing_pushes_back_on_an_interface_that_keeps_up():
    """Once in a window it is told what left, and that all of it could."""
    host = Host()
    host.told(1)
    ((pushes_back, sent),) = host.told(10)
    assert not pushes_back
    assert sent == pytest.approx(RATE, rel=1e-3)


@pytest.mark.parametrize("how", ["queue", "dropped", "blocked"])
def test_an_interface_that_cannot_keep_up_tells_its_rate(how):
    """A standing queue, a dropped packet, publishers that wait for room: each says that what left is what could."""
    host = Host()
    host.told(1)
    host.dropped += how == "dropped"
    host.blocked_s += 0.5 * (how == "blocked")
    ((pushes_back, sent),) = host.told(10, backlog=100_000 if how == "queue" else 0)
    assert pushes_back
    assert sent == pytest.approx(RATE, rel=1e-3)


def test_a_publisher_that_leaves_takes_its_waiting_along():
    """Less waiting than before is no waiting."""
    host = Host()
    host.blocked_s = 40.0
    host.told(1)
    host.blocked_s = 0.0
    ((pushes_back, _),) = host.told(10)
    assert not pushes_back


@pytest.mark.parametrize("other", [{"node": "/m"}, {"direction": Direction.ACTUATION}, {}])
def test_waiting_of_another_time_or_place_is_none(other):
    """Of a publisher that was not there before, one on another host, or one that was silent while it waited."""
    host = Host()
    host.publisher = replace(PUBLISHER, direction=other.get("direction", Direction.SENSING))
    host.told(1)
    host.publisher = replace(PUBLISHER, **other)
    host.blocked_s += 0.5 if other else 12.0
    ((pushes_back, _),) = host.told(10)
    assert not pushes_back


@pytest.mark.parametrize("mishap", ["gone", "anew"])
def test_a_window_with_a_mishap_in_it_is_none(mishap):
    """What was sent before an interface went or was made anew is not compared with what was sent after."""
    host = Host()
    assert len(host.told(6)) == 0
    if mishap == "anew":
        host.sent = host.dropped = 0
    host.told(1, is_there=mishap == "anew")
    assert host.told(9) == []
    ((pushes_back, sent),) = host.told(4)
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
def test_whatever_the_counters_do_it_is_a_length_and_a_rate(looks):
    """Counters that fall, stand still, vanish or are read twice at once: no exception, and nothing negative."""
    host = Host()
    for look in looks:
        host.sent = max(0, host.sent)
        queue = host.look(**look)
        assert 0.0 <= queue.backlog_s < float("inf")
        told = host.pushes_back()
        assert told is None or 0.0 <= told[1] < float("inf")


def test_a_window_with_an_outage_in_it_is_none():
    """What left before an interface lost its carrier is not averaged over the time in which nothing could."""
    host = Host()
    host.told(3)
    host.now_s += 10.0
    host.dropped += 1
    for pushes_back, sent in host.told(12):
        assert not pushes_back
        assert sent == pytest.approx(RATE, rel=1e-3)
