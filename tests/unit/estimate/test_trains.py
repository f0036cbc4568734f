"""Two packet sizes show the overhead of a packet and the capacity: exactly on an ideal link, despite bad trains."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate import probes
from arpd.estimate.trains import TrainLog
from arpd.model.link import CapacityKind
from arpd.model.probing import Train
from arpd.model.wire import probe_wire_bytes
from tests.unit.estimate.test_estimator import FIRST, SIZE
from tests.unit.estimate.test_estimator import PACKETS as SOME_PACKETS
from tests.unit.estimate.test_estimator import Link as MeasuredLink

LARGE = probe_wire_bytes(probes.PACKET_BYTES)
SMALL = probe_wire_bytes(probes.SMALL_PACKET_BYTES)
PAIRS = 6  # enough to be believed
PACKETS = 20


class Link:
    """A link on which s bytes take t_ovh + s/C, a part of the time of a large packet, and a log of its trains."""

    def __init__(self, overhead_s, part):
        self.log = TrainLog()
        self.overhead_s, self.capacity = overhead_s, part / (1.0 - part) * LARGE / overhead_s
        self.now_s = 50.0

    def packet_s(self, size):
        return self.overhead_s + size / self.capacity

    def train(self, size, *, longer=1.0, copies=1, after_s=0.1, sent=0.0):
        """Note a train of packets of some size, stretched by other traffic, that took a part of its time to leave."""
        self.now_s += after_s
        duration_s = longer * PACKETS * copies * self.packet_s(size)
        train = Train(payload_bytes=PACKETS * size, duration_s=duration_s, packets=PACKETS, sent_s=sent * duration_s)
        self.log.note(train, self.now_s, copies=copies)

    def pair(self, *, large=1.0, small=1.0, copies=1, sent=0.0):
        self.train(LARGE, longer=large, copies=copies, after_s=1.0)
        self.train(SMALL, longer=small, copies=copies, sent=sent)


LINKS = st.builds(Link, st.floats(52e-6, 5e-3), st.floats(0.04, 0.79))


@given(LINKS, st.integers(1, 4))
def test_pairs_tell_capacity_and_overhead_exactly(link, copies):
    """Pairs are exact on any link, at any overhead, with a copy per peer; each large train is taken once."""
    for _ in range(PAIRS):
        link.pair(copies=copies)
    assert link.log.packet_overhead_s == pytest.approx(link.overhead_s, rel=1e-6)
    overhead_s = link.log.packet_overhead_s
    taken = [link.log.take(packet_overhead_s=overhead_s, believed=math.inf) for _ in range(2)]
    assert [[seen.rate for seen in each] for each in taken] == [pytest.approx([link.capacity] * PAIRS, rel=1e-6), []]
    link.train(LARGE)
    link.log.clear()
    assert link.log.take(packet_overhead_s=0.0, believed=math.inf) == []


@given(LINKS, st.lists(st.floats(0.0, 0.99), min_size=4, max_size=10))
def test_trains_with_other_traffic_inside_do_not_matter(link, fills):
    """Small trains and every other large train that traffic made longer change nothing while two pairs are clean."""
    room = link.packet_s(LARGE) / link.packet_s(SMALL) - 1.0
    link.pair()
    for place, fill in enumerate(fills):
        link.pair(large=1.0 + fill * (place % 2), small=1.0 + fill * room)
    link.pair()
    assert link.log.packet_overhead_s == pytest.approx(link.overhead_s, rel=1e-6)


@given(LINKS, st.floats(0.71, 1.0))
def test_a_sender_that_is_slower_than_the_link_shows_no_overhead(link, sent):
    """Small packets that arrive as slowly as they left would make the sender's time the radio's."""
    for _ in range(PAIRS):
        link.pair(sent=sent)
    assert link.log.packet_overhead_s == 0.0


@pytest.mark.parametrize(("times", "least", "most"), [(0.3, 0.85, 1.1), (3.0, 2.9, 4.5)])
def test_a_train_that_arrives_as_it_left_shows_only_what_the_link_carries_at_least(times, least, most):
    """A sender that is slower than the link makes no link slow: its trains raise the capacity, and never lower it."""
    link = MeasuredLink()
    link.ticks(12)
    duration_s = SIZE / (times * FIRST)
    train = Train(payload_bytes=SIZE, duration_s=duration_s, packets=SOME_PACKETS, sent_s=0.9 * duration_s)
    estimate = link.ticks(10, trains=[train])
    assert estimate.kind is CapacityKind.PEER
    assert least < estimate.capacity_bytes_per_second / FIRST < most
