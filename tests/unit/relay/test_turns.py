"""When the lanes of an end may leave: kept, and the same as asking each of them."""

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.queue import PacedQueue
from arpd.model.plan import TopicPlan
from arpd.model.price import LARGE_SHARE
from arpd.relay.flight import Receipt
from arpd.relay.link_queue import LinkQueue
from tests.examples import examples
from tests.unit.relay.test_link_queue import CAPACITY, LARGE, ROW, Link, loads, price_of

JUST_S, SLOW = 1e-6, CAPACITY / 4
ROWS = [
    TopicPlan(rate_hz=rate_hz, min_rate_hz=0.2, deadline_ns=0, depth=1, weight=1.0, wire_bytes=900.0, packets=1)
    for rate_hz in (0.5, 3.0, 200.0)
]
PRICES = [None, *(price_of(share) for share in (1e-4, 1e-2, 10.0))]
LANES = 6
lanes = st.integers(0, LANES - 1)
events = st.one_of(
    st.tuples(st.just("offer"), st.sampled_from([50, 800, SMALL_BYTES + 1])),
    st.tuples(st.just("retune"), st.sampled_from(ROWS), st.sampled_from(PRICES)),
    st.sampled_from([("remove",), ("take",), ("confirm",)]),
)


def is_known(times, lane, due_s, now_s):
    """Return whether the lane is said to be ready when it is; at the very moment either will do."""
    times.departs_s = now_s
    return abs(due_s - now_s) < JUST_S or (lane in times.ready(now_s)) is (due_s <= now_s)


def act(queue, lane, what, about, now_s):
    """Let something happen to a lane, or to all."""
    if what == "offer":
        queue.offer(lane, bytes(about[0]), now_s)
    elif what == "retune":
        queue.retune(lane, *about)
    elif what == "remove":
        queue.remove(lane)
        queue.add(lane)
    elif what == "take":
        while queue.take(now_s) is not None:
            pass
    else:
        queue.flight.confirm(Receipt(session=7, number=queue.flight.send(33, now_s, size=0)), now_s)


def check(queue, lane, now_s):
    """Compare what is kept of a lane with what it says itself."""
    turns = queue._turns
    is_active = lane in queue._active
    assert [lane in times.ready(math.inf) for times in (turns.first, turns.in_turn)] == [is_active, is_active]
    if is_active:
        assert is_known(turns.first, lane, lane.first_s(now_s), now_s)
        assert is_known(turns.in_turn, lane, lane.spare_s(now_s), now_s)
        assert turns.finish[lane] == PacedQueue._finish(queue, lane)


@examples(60)
@given(st.lists(st.tuples(lanes, events, st.floats(0.0, 0.3)), max_size=60))
def test_what_is_kept_of_each_lane_is_what_it_says_itself(events):
    """After any order of offers, plans, prices, departures and removals, no lane's time is an old one."""
    queue, now_s = LinkQueue(7, 0.0, together=lambda _sample: None, freight=lambda _sample: None), 0.0
    lanes = [Lane(lambda _sample: None, has_company=number % 2 == 0) for number in range(LANES)]
    for lane in lanes:
        queue.add(lane)
    for number, (what, *about), wait_s in events:
        act(queue, lanes[number], what, about, now_s)
        now_s += wait_s
        queue._first(now_s)
        for lane in lanes:
            check(queue, lane, now_s)


@pytest.mark.parametrize("share", [0.6, 0.95])
def test_a_thousand_topics_are_not_all_asked_for_each_sample(share, monkeypatch):
    """On a link that carries a part of what they offer, a departure asks few lanes for their times."""
    asked, due_s = [], Lane.due_s
    monkeypatch.setattr(Lane, "due_s", lambda lane, *a, **more: (asked.append(lane), due_s(lane, *a, **more))[1])
    link, topics = Link(capacity=625_000.0), 300
    plan = TopicPlan(rate_hz=5.0, min_rate_hz=0.0, deadline_ns=0, depth=1, weight=1.0, wire_bytes=900.0, packets=1)
    for number in range(topics):
        link.lane(number, plan, price_of(share / topics), has_company=True)
        link.after(number / topics, lambda number=number: link.publish(number, 3.5, 800))
    link.run(2.0)
    assert sum(map(len, link.arrived.values())) > topics
    assert len(asked) / sum(map(len, link.arrived.values())) < 30


def test_many_small_topics_fill_a_link_that_they_overload():
    """Their packets follow each other while the link has time left, though together they cost less than each alone."""
    link = Link(capacity=CAPACITY / 4)
    price = replace(price_of(1.0 / 40), capacity_bytes_per_second=link.capacity)
    for number in range(40):
        name = f"topic {number}"
        link.lane(name, replace(ROW, rate_hz=62.5, wire_bytes=700.0, packets=1), price, has_company=True)
        link.after(0.0005 * number, partial(link.publish, name, 50.0, 400))
    link.run(2.0)
    assert link.run(5.0).total() / 5.0 > 0.9


def withheld_beside_cameras(share, *topics, large_share=0.0):
    """Return what topics with this rate, size and wire size lose in 3 s, and how many pictures of two cameras cross."""
    link = Link(capacity=SLOW)
    price = replace(
        price_of(share), capacity_bytes_per_second=SLOW, budget_share=0.85, large_share_per_weight=large_share
    )
    for number, (rate_hz, size, wire_bytes) in enumerate(topics):
        link.lane(
            number, replace(ROW, rate_hz=1.25 * rate_hz, wire_bytes=wire_bytes, packets=1), price, has_company=True
        )
        link.after(0.0007 * number, partial(link.publish, number, rate_hz, size))
    for camera in ("left", "right"):
        link.lane(camera, ROW, price)
        link.publish(camera, 30.0)
    link.run(3.0)
    pictures = len(link.arrived["left"] + link.arrived["right"])
    return sum(link.lanes[number].withheld.total() for number in range(len(topics))), pictures


def test_topics_that_share_packets_are_charged_for_what_they_take():
    """A price that leaves 345 Hz in packets of their own to a topic of 500 Hz costs it nothing in those of others."""
    withheld, pictures = withheld_beside_cameras(0.2, (250.0, 350, 540.0), (500.0, 110, 300.0))
    assert withheld < 30
    assert pictures > 5


def test_messages_beyond_their_rate_join_those_that_leave():
    """Others leave all the time, and each time the link has just been taken by a picture."""
    withheld, pictures = withheld_beside_cameras(0.035, *20 * [(50.0, 120, 320.0)], *8 * [(100.0, 120, 320.0)])
    assert withheld < 30
    assert pictures > 5


ARM = ((500.0, 100, 286.0), (100.0, 600, 786.0))  # wrenches and transforms


def test_a_picture_costs_topics_of_one_packet_nothing_where_they_fit():
    """Joint states whose rate is above their share of the link leave before two cameras, which have the rest."""
    withheld, pictures = withheld_beside_cameras(0.2, (500.0, 400, 586.0), *ARM)
    assert not withheld
    assert pictures > 3


def test_a_part_of_the_link_is_left_to_pictures():
    """Joint states that would fill it have most of it beyond their rate, and no more."""
    withheld, pictures = withheld_beside_cameras(0.15, (1500.0, 400, 586.0), *ARM, large_share=LARGE_SHARE / 2)
    assert withheld > 1000
    assert pictures > 2


def pictures_beside_forty_topics(floor_hz):
    """Return how many pictures of 30 kB with this floor come in 6 s, beside topics that would fill the link."""
    link = Link(capacity=SLOW)
    price = replace(price_of(0.02), capacity_bytes_per_second=SLOW, budget_share=0.85)
    for number in range(40):
        row = replace(ROW, rate_hz=50.0, wire_bytes=800.0, packets=1)
        link.lane(number, row, price, has_company=True)
        link.after(0.0007 * number, partial(link.publish, number, 40.0, 400))
    plan = replace(ROW, rate_hz=25.0, min_rate_hz=floor_hz, wire_bytes=34_000.0, packets=25)
    link.lane("pictures", plan, price)
    link.publish("pictures", 20.0, 30_000)
    link.run(6.0)
    return len(link.arrived["pictures"])


def test_a_picture_keeps_its_floor_though_small_topics_fill_the_link():
    """What they have beyond their rates comes after it."""
    assert pictures_beside_forty_topics(0.0) < 4
    assert pictures_beside_forty_topics(2.0) in (11, 12, 13)


def test_a_map_below_its_floor_lets_pictures_by():
    """It catches up for half a second of the link, and then takes turns with them."""
    link = Link(capacity=SLOW)
    price = replace(price_of(1.0), capacity_bytes_per_second=SLOW)
    link.lane("pictures", replace(ROW, rate_hz=12.5, wire_bytes=34_000.0, packets=25), price)
    link.lane("map", replace(ROW, rate_hz=1.0, min_rate_hz=0.1, wire_bytes=2_300_000.0, packets=1700), price)
    link.publish("pictures", 10.0, 30_000)
    link.run(2.0)
    link.offer("map", bytes(2_000_000))
    link.run(12.0)
    assert [len(message) for message in link.arrived["map"]] == [2_000_000]
    assert max(late - early for early, late in pairwise(link.arrived_s["pictures"])) < 1.5


def test_a_quick_topic_that_has_lost_samples_does_not_go_on_losing_them():
    """After a second of a price that costs some, those that come between two departures leave with the second one."""
    link, lanes = Link(capacity=SLOW), {}
    plan = replace(ROW, rate_hz=625.0, wire_bytes=586.0, packets=1)
    for name in ("joints", "wrench"):
        lanes[name] = link.lane(name, plan, has_company=True)
        link.publish(name, 500.0, 250)
    camera = link.lane("camera", ROW)
    link.publish("camera", 15.0)
    lost = []
    for capacity in (SLOW, SLOW / 3, SLOW):
        price = replace(price_of(0.2), capacity_bytes_per_second=capacity, budget_share=0.85)
        for lane in lanes.values():
            link.queue.retune(lane, plan, price)
        link.queue.retune(camera, ROW, price)
        link.run(1.0)
        before = sum(lane.withheld.total() for lane in lanes.values())
        link.run(1.0)
        lost.append(sum(lane.withheld.total() for lane in lanes.values()) - before)
    assert lost[1] > 100
    assert max(lost[0], lost[2]) < 10


def test_commands_leave_though_the_robots_topics_fill_the_link():
    """A topic of one packet has a part of it that nobody has planned for, as the only one of its end."""
    link = Link(capacity=SLOW / 2.5)
    price = replace(price_of(0.02), capacity_bytes_per_second=link.capacity)
    lane = link.lane("setpoint", replace(ROW, rate_hz=20.0, wire_bytes=500.0, packets=1), price, has_company=True)
    link.publish("setpoint", 50.0, 100)
    link.run(4.0)
    assert lane.sent_rate.samples >= 195


def beside_an_imu_and_a_camera(plan):
    """Return what an IMU loses in 3 s, and the bytes of a camera and of pictures of 11 kB and 60 Hz with this plan."""
    link = Link(capacity=SLOW)
    price = replace(price_of(0.3), capacity_bytes_per_second=SLOW, budget_share=0.85)
    imu = link.lane("imu", replace(ROW, rate_hz=125.0, wire_bytes=585.0, packets=1), price, has_company=True)
    link.lane("camera", ROW, price)
    link.lane("pictures", plan, price)
    for name, rate_hz, size in (("imu", 100.0, 344), ("camera", 30.0, LARGE), ("pictures", 60.0, 11_000)):
        link.publish(name, rate_hz, size)
    link.run(3.0)
    return imu.withheld.total(), len(link.arrived["camera"]) * LARGE, len(link.arrived["pictures"]) * 11_000


def test_a_new_topic_of_several_packets_leaves_the_others_their_time():
    """Before its plan, pictures that would take the whole link cost an IMU nothing, and a camera half of it."""
    withheld, *carried = beside_an_imu_and_a_camera(Lane(lambda _sample: None).plan)
    assert not withheld
    assert min(carried) > 300_000


def test_a_topic_whose_samples_grow_takes_no_more_of_the_link_than_planned():
    """Until its next plan fewer of the larger samples leave before others."""
    withheld, *carried = beside_an_imu_and_a_camera(replace(ROW, rate_hz=75.0, wire_bytes=1_700.0, packets=2))
    assert not withheld
    assert min(carried) >= 200_000


def test_under_a_uniform_policy_each_sample_costs_the_same():
    """Its terms are nominal, so neither company nor size changes the one rate of all."""
    link, nominal = Link(), replace(ROW, rate_hz=10.0, wire_bytes=1000.0, packets=0)
    scan = link.lane("scan", nominal, price_of(0.004))
    link.publish("scan", 10.0, 11_000)
    link.run(3.0)
    assert scan.due_s(link.now_s) <= link.now_s + 0.1


def test_a_large_message_makes_way_for_a_moment_while_small_ones_wait_for_the_processor():
    """Its chunks wait, small messages leave meanwhile, and the thread wakes for it by itself."""
    link = Link()
    link.lane("image")
    link.lane("imu")
    link.offer("image", bytes(100_000))
    assert link.take()[0] is link.lanes["image"]
    link.queue.make_way(link.now_s)
    assert link.take() is None
    link.offer("imu", b"imu")
    assert link.take()[0] is link.lanes["imu"]
    again_s = link.queue.due_s(link.now_s)
    assert link.now_s + 0.01 < again_s < link.now_s + 0.03
    link.now_s = again_s
    assert link.take()[0] is link.lanes["image"]


def test_a_topic_with_a_message_larger_than_a_packet_leaves_alone_from_then_on():
    """Its small messages would overtake the large one on another writer."""
    link = Link()
    scan = link.lane("scan", has_company=True)
    for size in (100, 5000, 100):
        link.offer("scan", bytes(size))
        assert (loads(link) == ([], 1)) == (not scan.has_company)
        link.now_s += 0.1
    assert not scan.has_company
