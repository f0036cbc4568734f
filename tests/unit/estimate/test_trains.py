"""Two packet sizes show the overhead of a packet and the capacity: exactly on an ideal link, despite bad trains."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate import probes
from arpd.estimate.trains import TrainLog
from arpd.model.probing import Train
from arpd.model.wire import probe_wire_bytes

LARGE = probe_wire_bytes(probes.PACKET_BYTES)
SMALL = probe_wire_bytes(probes.SMALL_PACKET_BYTES)
PAIRS = 6  # enough to be believed


class Link:
    """A link on which s bytes take t_ovh + s/C, and a log of its trains."""

    def __init__(self, capacity, overhead_s=0.0):
        self.log = TrainLog()
        self.capacity, self.overhead_s = capacity, overhead_s
        self.now_s = 50.0

    def packet_s(self, size):
        return self.overhead_s + size / self.capacity

    def train(self, size, *, longer=1.0, packets=20, sent=0.0, copies=1, after_s=0.1):
        """Note a train of packets of some size, stretched by other traffic."""
        self.now_s += after_s
        duration_s = longer * packets * copies * self.packet_s(size)
        train = Train(payload_bytes=packets * size, duration_s=duration_s, packets=packets, sent_s=sent * duration_s)
        self.log.note(train, self.now_s, copies=copies)

    def pair(self, *, large=1.0, small=1.0, sent=0.0, copies=1):
        self.train(LARGE, longer=large, copies=copies, after_s=1.0)
        self.train(SMALL, longer=small, sent=sent, copies=copies)

    def pairs(self, count=PAIRS, **options):
        for _ in range(count):
            self.pair(**options)
        return self

    @property
    def capacities(self):
        return self.log.take(packet_overhead_s=self.log.packet_overhead_s)


def with_overhead(capacity, part):
    """Return a link whose overhead is a part of the time of a large packet."""
    return Link(capacity, part / (1.0 - part) * LARGE / capacity)


def capacity_of(overhead_s, part):
    """Return the capacity of a link on which an overhead is a part of the time of a large packet."""
    return part / (1.0 - part) * LARGE / overhead_s


OVERHEADS_S = st.floats(52e-6, 5e-3)
PARTS = st.floats(0.04, 0.79)


@given(OVERHEADS_S, PARTS, st.integers(1, 4))
def test_pairs_tell_capacity_and_overhead_exactly(overhead_s, part, copies):
    """Pairs are exact on any link, at any overhead, with a copy per peer; only large packets show the capacity."""
    capacity = capacity_of(overhead_s, part)
    link = with_overhead(capacity, part).pairs(copies=copies)
    assert link.log.packet_overhead_s == pytest.approx(link.overhead_s, rel=1e-6)
    assert link.capacities == pytest.approx([capacity] * PAIRS, rel=1e-6)


@given(OVERHEADS_S, PARTS, st.lists(st.floats(0.0, 0.99), min_size=4, max_size=10))
def test_trains_with_other_traffic_inside_do_not_matter(overhead_s, part, fills):
    """Small trains and every other large train that traffic made longer change nothing while two pairs are clean."""
    capacity = capacity_of(overhead_s, part)
    link = with_overhead(capacity, part)
    room = link.packet_s(LARGE) / link.packet_s(SMALL) - 1.0
    link.pair()
    for place, fill in enumerate(fills):
        link.pair(large=1.0 + fill * (place % 2), small=1.0 + fill * room)
    link.pair()
    assert link.log.packet_overhead_s == pytest.approx(link.overhead_s, rel=1e-6)


def test_each_train_is_taken_once():
    """Trains of large packets since the last call are news once, in their order; cleared ones are none."""
    link = Link(1e6)
    for capacity in (1e6, 2e6):
        link.capacity = capacity
        link.train(LARGE)
        link.train(SMALL)
    taken = [link.log.take(packet_overhead_s=0.0) for _ in range(2)]
    assert taken == [pytest.approx([1e6, 2e6]), []]
    link.train(LARGE)
    link.log.clear()
    assert link.log.take(packet_overhead_s=0.0) == []
