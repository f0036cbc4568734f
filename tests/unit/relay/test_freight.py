"""Large messages of a clean link leave in datagrams of several packets, while these arrive."""

import math
from collections import defaultdict
from dataclasses import replace
from functools import partial
from itertools import pairwise

import pytest

from arpd.endpoint.lane import Lane
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.relay.envelope import Assembly, Record, decode_chunk, pack, unpack
from arpd.relay.flight import Received
from arpd.relay.link_queue import LinkQueue

PICTURE = bytes(200_000)
PRICE = Price(share_per_weight=1.0, capacity_bytes_per_second=2.5e6, packet_overhead_s=1e-4, loss_ratio=0.0)
ROW = TopicPlan(
    rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=1, weight=1.0, wire_bytes=1.1 * len(PICTURE), packets=165
)


class Link:
    """One end's queue, and the other end, which has each chunk 10 ms after it left."""

    def __init__(self, price=PRICE):
        self.price, self.now_s, self.drops = price, 100.0, False
        self.queue = LinkQueue(
            7, self.now_s, together=partial(self.write, "together"), freight=partial(self.write, "freight")
        )
        self.received, self.lanes, self.sent = Received(), {}, defaultdict(int)
        self.assemblies, self.arrived = defaultdict(Assembly), defaultdict(list)

    def lane(self, name, **options):
        self.lanes[name] = Lane(partial(self.write, name), **options)
        self.queue.add(self.lanes[name])
        self.queue.retune(self.lanes[name], ROW, self.price)

    def retune(self, price):
        for lane in self.lanes.values():
            self.queue.retune(lane, ROW, price)

    def offer(self, name, number, sample=PICTURE):
        message = pack([Record(name.ljust(8).encode(), number, sample)])
        self.queue.offer(self.lanes[name], message, self.now_s)

    def write(self, writer, sample):
        self.sent[writer] += 1
        if self.drops and writer == "freight":
            return
        chunk = decode_chunk(sample)
        self.received.note(7, chunk.number, chunk.departed_us, len(sample), self.now_s + 0.01)
        for record in unpack(self.assemblies[writer].add(chunk) or b""):
            self.arrived[record.writer.decode().strip()].append((record.sequence, writer))

    def run(self, for_s):
        end_s = self.now_s + for_s
        while self.now_s < end_s:
            while (ready := self.queue.take(self.now_s)) is not None:
                ready.lane.write(ready.sample)
            self.now_s += 0.02
            self.queue.flight.confirm(self.received.take(self.now_s), self.now_s)


def test_pictures_of_several_topics_cross_whole_in_datagrams():
    """Their chunks leave by turns on one writer, and the other end puts each message together."""
    link = Link()
    for name in ("left", "right"):
        link.lane(name)
        link.offer(name, 1)
    link.run(2.0)
    assert dict(link.arrived) == {"left": [(1, "freight")], "right": [(1, "freight")]}


@pytest.mark.parametrize("price", [None, replace(PRICE, loss_ratio=None), replace(PRICE, loss_ratio=0.02)])
def test_a_link_that_may_lose_packets_carries_no_datagram_of_several(price):
    """One lost packet would cost all of it."""
    link = Link(price)
    link.lane("camera")
    link.offer("camera", 1)
    link.run(2.0)
    assert dict(link.arrived) == {"camera": [(1, "camera")]}


def test_what_must_not_be_lost_stays_on_its_own_writer():
    """Two writers may overtake each other, and then the other end drops the older sample."""
    link = Link()
    link.lane("events", is_kept=True)
    link.lane("scan")
    link.offer("events", 1)
    link.offer("scan", 1, bytes(9000))
    link.run(2.0)
    assert dict(link.arrived) == {"scan": [(1, "scan")], "events": [(1, "events")]}


def test_a_message_stays_on_the_writer_that_began_it():
    """The link begins to lose packets in the middle of a picture, and it still crosses whole."""
    link = Link()
    link.lane("camera")
    link.offer("camera", 1)
    link.run(0.03)
    link.retune(replace(PRICE, loss_ratio=0.02))
    link.offer("camera", 2)
    link.run(2.0)
    assert link.arrived["camera"] == [(1, "freight"), (2, "camera")]


def test_where_no_datagram_arrives_pictures_go_on_in_packets():
    """A second later the message under way begins again; datagrams are tried again after ever longer times."""
    link = Link()
    link.lane("camera")
    link.lane("imu")
    link.drops, tried_s = True, [link.now_s]
    for number in range(1, 1900):
        before = link.sent["freight"]
        link.offer("camera", number, 2 * PICTURE)  # some of it is still to leave when that is noticed
        for _ in range(5):
            link.offer("imu", number, bytes(300))
            link.run(0.02)
        if link.sent["freight"] > before and link.now_s > tried_s[-1] + 1.0:
            tried_s.append(link.now_s)
    pauses_s = [after - before for before, after in pairwise(tried_s)]
    assert pauses_s == pytest.approx([60.0, 120.0], abs=1.5)
    numbers = [number for number, _ in link.arrived["camera"]]
    assert all(0 < after - before < 15 for before, after in pairwise(numbers))
    assert numbers[0] == 1
    assert numbers[-1] > 1890
    link.drops = False
    link.run(300.0)
    link.offer("camera", 1900)
    link.run(1.0)
    assert link.arrived["camera"][-1] == (1900, "freight")
