"""One paced queue whose messages cross in chunks: what leaves next onto a link in virtual time, and how much of it."""

import heapq
import math
from collections import Counter, defaultdict
from dataclasses import replace
from functools import partial
from itertools import count, pairwise

import pytest

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.model.plan import TopicPlan
from arpd.model.price import Price
from arpd.model.wire import FRAGMENT_BYTES, wire_size
from arpd.relay.envelope import Assembly, Chunk, decode_chunk, encode_chunk
from arpd.relay.flight import Receipt, Received, Sign, decode_sign, encode_sign
from arpd.relay.link_queue import LinkQueue

CAPACITY, OVERHEAD_S = 2.5e6, 1e-4
LARGE, SMALL = 100_000, 500
ROW = TopicPlan(
    rate_hz=math.inf, min_rate_hz=0.0, deadline_ns=0, depth=1, weight=1.0, wire_bytes=1.1 * LARGE, packets=83
)


def price_of(share_per_weight, spare_share=0.0):
    return Price(
        share_per_weight=share_per_weight,
        capacity_bytes_per_second=CAPACITY,
        packet_overhead_s=OVERHEAD_S,
        spare_share=spare_share,
    )


class Link:
    """A queue that sends over a link, and the other end that puts together and confirms."""

    def __init__(self, capacity=CAPACITY):
        self.capacity = capacity
        self.now_s = 4290.0  # the µs of its clock wrap after 5 s
        self.received = Received()
        self.queue = LinkQueue(
            7,
            self.now_s,
            together=partial(self.write, "together", Assembly()),
            freight=partial(self.write, "freight", Assembly()),
        )
        self.flight = self.queue.flight
        self.lanes, self.sent_s, self.arrived = {}, Counter(), defaultdict(list)
        self.events, self.order, self.free_s = [], count(), 0.0
        self.arrived_s = defaultdict(list)

    def lane(self, name, plan=None, price=None, **options):
        self.lanes[name] = Lane(partial(self.write, name, Assembly()), **options)
        self.queue.add(self.lanes[name])
        if plan is not None:
            self.queue.retune(self.lanes[name], plan, price)
        return self.lanes[name]

    def after(self, wait_s, act):
        heapq.heappush(self.events, (self.now_s + wait_s, next(self.order), act))

    def offer(self, name, message, **more):
        self.queue.offer(self.lanes[name], message, self.now_s, **more)

    def publish(self, name, rate_hz, size=LARGE):
        """Offer a message now and then, for ever."""
        self.offer(name, bytes(size))
        self.after(1.0 / rate_hz, partial(self.publish, name, rate_hz, size))

    def take(self):
        """Return the lane, the place and the size of what leaves now."""
        if (ready := self.queue.take(self.now_s)) is None:
            return None
        chunk = decode_chunk(ready.sample)
        return ready.lane, chunk.offset, len(chunk.part)

    def confirm_all(self):
        """Let a probe arrive, and with it all that left before."""
        self.flight.confirm(Receipt(session=7, number=self.flight.send(33, self.now_s, size=0)), self.now_s)

    def run(self, for_s):
        """Return how much of the link's time each topic took (s)."""
        before, end_s = self.sent_s.copy(), self.now_s + for_s
        while self.now_s < end_s:
            while (ready := self.queue.take(self.now_s)) is not None:
                ready.lane.write(ready.sample)
            if self.now_s >= self.received.due_s():
                receipt = self.received.take(self.now_s)
                self.after(0.002, lambda receipt=receipt: self.flight.confirm(receipt, self.now_s))
            due_s = min(end_s, self.queue.due_s(self.now_s), self.received.due_s(), *(at for at, *_ in self.events[:1]))
            self.now_s = max(due_s, self.now_s + 1e-6)
            while self.events and self.events[0][0] <= self.now_s:
                heapq.heappop(self.events)[2]()
        return self.sent_s - before

    def write(self, name, assembly, sample):
        size, packets = wire_size(len(sample), rate_hz=math.inf)
        took_s = size / self.capacity + packets * OVERHEAD_S
        self.sent_s[name] += took_s
        self.free_s = max(self.free_s, self.now_s) + took_s
        self.after(self.free_s - self.now_s + 0.002, partial(self.arrive, name, assembly, sample))

    def arrive(self, name, assembly, sample):
        chunk = decode_chunk(sample)
        self.received.note(chunk.session, chunk.number, chunk.departed_us, len(sample), self.now_s)
        if (message := assembly.add(chunk)) is not None:
            self.arrived[name].append(message)
            self.arrived_s[name].append(self.now_s)


def test_small_messages_leave_before_a_large_one_under_way():
    """A message of ten packets leaves whole though large ones must wait, and these go on where they were."""
    link = Link()
    large, small = link.lane("large"), link.lane("small")
    link.offer("large", bytes(LARGE))
    parts = sum(part for _, _, part in iter(link.take, None))
    assert 0 < parts < LARGE
    link.offer("small", bytes(SMALL_BYTES))
    assert SMALL_BYTES > 9.9 * FRAGMENT_BYTES
    assert link.take() == (small, 0, SMALL_BYTES)
    link.confirm_all()
    assert link.take()[:2] == (large, parts)


def test_a_large_message_is_not_torn_by_newer_ones_and_the_newest_follows():
    """Each message that begins is finished; of those that came meanwhile only the newest is sent."""
    link = Link()
    link.lane("camera")
    for picture in b"0123":
        link.offer("camera", bytes([picture]) * LARGE)
        link.run(0.005)
    link.run(1.0)
    assert link.arrived["camera"] == [b"0" * LARGE, b"3" * LARGE]


@pytest.mark.parametrize("capacity", [6e5, 5e7])
def test_a_message_under_way_crosses_whole_though_chunks_grow(capacity):
    """A link that rises lets a chunk hold more than a whole message; of one under way only the rest follows."""
    link, slow = Link(), replace(price_of(1.0), capacity_bytes_per_second=6e5)
    lane = link.lane("scan", replace(ROW, weight=1e-6), slow)
    message = bytes(k % 251 for k in range(15_000))
    link.offer("scan", message)
    link.arrive("scan", assembly := Assembly(), link.queue.take(link.now_s).sample)
    link.queue.retune(lane, ROW, replace(slow, capacity_bytes_per_second=capacity))
    while not link.arrived["scan"]:
        link.confirm_all()
        link.now_s += 0.01
        while (ready := link.queue.take(link.now_s)) is not None:
            link.arrive("scan", assembly, ready.sample)
    assert link.arrived["scan"] == [message]


@pytest.mark.parametrize("price", [None, price_of(0.2)], ids=["no daemon", "daemon"])
def test_large_topics_share_the_link_by_weight(price):
    """Of two that want all, one with twice the weight gets twice the link."""
    link = Link()
    for name, weight in (("one", 1.0), ("two", 2.0)):
        link.lane(name, price and replace(ROW, weight=weight), price, weight=weight)
        link.publish(name, 50.0)
    used_s = link.run(12.0)  # long enough that one message is little
    assert used_s["two"] / used_s["one"] == pytest.approx(2.0, rel=0.05)


def test_of_two_pictures_one_crosses_after_the_other():
    """Two large messages of equal weight do not take turns, by which both would be late."""
    link = Link()
    for name in "ab":
        link.lane(name, ROW, price_of(0.5))
        link.offer(name, bytes(5 * LARGE))
    link.run(1.0)
    (first_s,), (second_s,) = link.arrived_s.values()
    assert second_s - link.now_s + 1.0 > 1.8 * (first_s - link.now_s + 1.0)


def test_a_huge_message_keeps_others_waiting_for_two_seconds_at_most():
    """A map of six seconds of the link lets pictures of another topic cross meanwhile."""
    link = Link()
    for name in ("map", "picture"):
        link.lane(name, ROW, price_of(0.5))
    link.offer("map", bytes(int(6 * CAPACITY)))
    link.publish("picture", 50.0)
    link.run(20.0)
    assert link.arrived["map"]
    assert max(after - before for before, after in pairwise(link.arrived_s["picture"])) < 2.6


@pytest.mark.parametrize(("share", "price"), [(0.2, price_of(0.1)), (0.8, price_of(0.4)), (0.5, price_of(0.1, 0.3))])
@pytest.mark.parametrize("busy", ["ab", "a"])
def test_the_share_at_the_price_is_used_and_no_more(busy, share, price):
    """The queue drains at its topics' rates at the price and what is spare; what one leaves another has at once.

    Where no queue stands on the link it takes a seventh more, of the headroom.
    """
    link = Link()
    for name in "ab":
        link.lane(name, ROW, price)
    for name in busy:
        link.publish(name, 50.0)
    link.run(1.0)
    assert 0.98 * share < link.run(5.0).total() / 5.0 < 1.16 * share


@pytest.mark.parametrize("planned_hz", [math.inf, 5.0])
def test_what_is_left_serves_small_topics_beyond_their_rate(planned_hz):
    """Neither a rate at the price nor a source slower at the plan withholds what the link carries."""
    link = Link()
    link.lane("tf", replace(ROW, rate_hz=planned_hz, wire_bytes=SMALL, packets=1), price_of(0.003, 0.5))
    link.publish("tf", 100.0, SMALL)
    link.run(2.0)
    assert len(link.arrived["tf"]) >= 195


@pytest.mark.parametrize("price", [None, price_of(math.inf, 0.5)], ids=["no daemon", "free link"])
@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_max_rate_is_a_cap_on_a_free_link_too(price, size):
    """A topic with `max_rate_hz` does not exceed it where nothing else wants the link."""
    link = Link()
    link.lane("topic", replace(ROW, rate_hz=5.0, max_rate_hz=5.0, wire_bytes=size), price)
    link.publish("topic", 20.0, size)
    link.run(10.0)
    assert len(link.arrived["topic"]) == pytest.approx(51, abs=2)


def test_a_large_topic_below_its_floor_comes_first():
    """A topic of little weight has its minimum rate beside one that wants all."""
    link = Link()
    for name, plan in (("busy", ROW), ("rare", replace(ROW, weight=0.01, min_rate_hz=2.0))):
        link.lane(name, plan, price_of(0.5))
        link.publish(name, 50.0)
    link.run(5.0)
    assert len(link.arrived["rare"]) in {10, 11}


@pytest.mark.parametrize("capacity", [0.12 * CAPACITY, CAPACITY, 2.0 * CAPACITY])
@pytest.mark.parametrize("price", [None, price_of(math.inf)], ids=["no daemon", "daemon"])
def test_no_more_than_a_quarter_of_a_second_stands_on_the_link(capacity, price):
    """A link is used and not flooded, without a daemon and with one that believes in eight times as much."""
    link = Link(capacity)
    for name, rate_hz, size in (("tf", 200.0, SMALL), ("camera", 60.0, LARGE)):
        link.lane(name, price and replace(ROW, wire_bytes=size), price)
        link.publish(name, rate_hz, size)
    for _ in range(300):
        link.run(0.01)
        assert link.free_s - link.now_s <= 0.25
    assert link.sent_s.total() > 0.9 * 3.0 * min(1.0, CAPACITY / capacity)


def test_after_a_fall_the_queue_on_the_link_is_short_before_a_daemon_knows():
    """What fills a link that falls to a quarter waits for 0.12 s at most, with the old price, and soon for less."""
    link = Link()
    link.lane("camera", ROW, price_of(math.inf))
    link.publish("camera", 60.0)
    link.run(3.0)
    link.capacity, waits_s = link.capacity / 4.0, []
    for _ in range(60):
        link.run(0.01)
        waits_s.append(link.free_s - link.now_s)
    assert 0.05 < max(waits_s) < 0.12
    assert max(waits_s[30:]) < 0.05


def test_of_what_waited_when_an_outage_began_the_newest_leaves():
    """Samples that came before anybody could know that the link was out are old when it returns."""
    link = Link()
    tf = link.lane("tf")
    while link.flight.has_room(is_small=True):
        link.flight.send(1000, link.now_s, size=1000)
    for number in range(6):
        link.offer("tf", bytes(number), source=number % 2)
    link.now_s += 0.5
    assert link.take() is None
    link.confirm_all()
    assert [link.take(), link.take(), link.take()] == [(tf, 0, 4), (tf, 0, 5), None]
    assert tf.withheld == {"blocked": 4}


def test_after_an_outage_the_newest_of_each_source_leaves_once():
    """While receipts are missing nothing leaves; when one comes, two sources have a sample each, the newest."""
    link = Link()
    tf = link.lane("tf")
    link.offer("tf", b"")
    link.take()
    link.now_s += 0.5
    for number in range(20):
        link.offer("tf", bytes(number), source=number % 2)
        assert link.take() is None
    link.confirm_all()
    assert [link.take(), link.take(), link.take()] == [(tf, 0, 18), (tf, 0, 19), None]
    assert tf.withheld == {"blocked": 18}


def loads(link):
    """Return the letters in each packet of messages that leave together now, and how many others leave alone."""
    ready = list(iter(lambda: link.queue.take(link.now_s), None))
    together = [decode_chunk(sample).part for lane, sample in ready if lane not in link.lanes.values()]
    return ["".join(dict.fromkeys(part.decode())) for part in together], len(ready) - len(together)


def test_small_messages_that_come_together_leave_together():
    """The first leaves at once; those that come while it takes the link leave together, or alone without company.

    Where the link loses packets each one leaves by itself, because a lost one holds up all that is in its message.
    """
    link = Link()
    for name in "abcd":
        link.lane(name, ROW, price_of(1.0), has_company=name != "d")
    link.offer("a", b"a" * 100)
    assert loads(link) == (["a"], 0)
    for name in "bcd":
        link.offer(name, name.encode() * 100)
    assert loads(link) == ([], 1)
    link.now_s = link.queue.due_s(link.now_s)
    assert loads(link) == (["bc"], 0)
    for loss_ratio, packets in ((0.01, ["ab", "c"]), (0.0, ["abc"])):
        link.now_s += 1.0
        link.confirm_all()
        for name in "abc":
            link.queue.retune(link.lanes[name], ROW, replace(price_of(1.0), loss_ratio=loss_ratio))
            link.offer(name, name.encode() * 500)
        assert loads(link) == (packets, 0), "what finds no room leaves in the next packet, at once"


def test_a_topic_quicker_than_packets_leave_does_not_wait():
    """Its messages of the time of two packets leave in one, so that 500 Hz cross a link of 5 Mbit/s as they come."""
    link = Link(capacity=CAPACITY / 4)
    price = replace(price_of(1.0), capacity_bytes_per_second=link.capacity)
    quick = link.lane("quick", replace(ROW, wire_bytes=300.0, packets=1), price, has_company=True)
    link.publish("quick", 500.0, 100)
    link.run(2.0)
    assert len(quick) <= 2
    assert quick.withheld.total() == 0


def test_the_thread_wakes_by_itself_for_what_quick_topics_will_bring():
    """After a packet of several messages the next departure is due without any; after one of a single message none."""
    link = Link()
    for name in "ab":
        link.lane(name, has_company=True)
    link.offer("a", bytes(100))
    assert loads(link)[0]
    assert math.isinf(link.queue.due_s(link.now_s))
    for name in "ab":
        link.offer(name, bytes(100))
    link.now_s = link.queue.due_s(link.now_s)
    assert loads(link)[0]
    due_s = link.queue.due_s(link.now_s)
    assert link.now_s < due_s < link.now_s + 0.01
    assert math.isinf(link.queue.due_s(due_s))


def test_another_robots_end_in_the_link_domain_spoils_no_account():
    """While the other end speaks, only its chunks and probes are receipted; when it is silent, its successor's are."""
    end = LinkQueue(1, 0.0, together=lambda _sample: None, freight=lambda _sample: None)
    other, stranger, successor = 2, 3, 4

    def sends(session, number, now_s):
        end.arrived(encode_chunk(Chunk(session, number, 0, number, 0, 4, is_kept=False, part=b"part")), now_s)

    def receipt(now_s):
        return decode_sign(end.take_sign(now_s)).receipt

    end.follow(other, 0.0)
    sent = end.flight.send(1000, 0.0, size=1000)
    for each, is_on_its_way in ((stranger, True), (other, False)):  # both read what is sent
        end.hear(encode_sign(Sign(each, receipt=Receipt(session=1, number=sent, at_us=1))), 0.1)
        assert math.isfinite(end.flight.out_s) == is_on_its_way
    sends(other, 1, 0.1)
    size = receipt(0.5).received
    for number, now_s in enumerate((1.0, 1.5), start=2):
        sends(stranger, 70 + number, now_s)
        sends(other, number, now_s)
        end.hear(encode_sign(Sign(stranger, number=9)), now_s)
    after = receipt(2.0)
    assert (after.session, after.number, after.received) == (other, 3, 3 * size)
    sends(successor, 1, 1.5 + 1.6)
    assert receipt(4.0).session == successor


@pytest.mark.parametrize(("drift", "slept_s"), [(1e-4, 0.0), (0.0, 1000.0)])
def test_after_hours_in_which_nothing_crossed_a_sample_is_as_old_as_it_is(drift, slept_s):
    """In hours the clocks of two hosts part by a second, and that of a laptop stands still while it sleeps."""
    asleep_s = 0.0
    base = LinkQueue(1, 0.0, together=lambda _sample: None, freight=lambda _sample: None, asleep_s=lambda: asleep_s)
    robot = LinkQueue(2, 0.0, together=lambda _sample: None, freight=lambda _sample: None)
    base.add(lane := Lane(lambda _sample: None))
    base.follow(2, 0.0)
    robot.follow(1, 0.0)

    def age_s(now_s, late_s):
        base.offer(lane, b"go", now_s - asleep_s)
        return robot.arrived(base.take(now_s - asleep_s).sample, now_s * (1.0 + drift) + late_s)[1]

    age_s(0.0, 0.0)
    for now_s in range(1, 20_000):
        robot.hear(base.take_sign(now_s), now_s * (1.0 + drift))
        base.flight.restart()  # the robot has said that it heard all
    asleep_s = slept_s
    assert [age_s(20_000.0 + slept_s + late_s, late_s) for late_s in (0.7, 0.0)] == pytest.approx([0.7, 0.0], abs=0.01)
