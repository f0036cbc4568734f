"""What waits of one topic, and which sample leaves when its turn comes."""

import math
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.model.plan import TopicPlan
from arpd.model.price import Price

LARGE = bytes(SMALL_BYTES)  # after the number in front of it


def make(rate_hz=math.inf, *, depth=1, **options):
    """Return a lane with a rate and a DEPTH that a plan gives it."""
    lane = Lane(lambda _sample: None, **options)
    lane.retune(TopicPlan(rate_hz=rate_hz, min_rate_hz=0.0, deadline_ns=0, depth=depth, weight=1.0), None)
    return lane


def leave(lane, now_s=0.0):
    """Let the next message leave; return its source and the number in front of it."""
    current = lane.begin(now_s)
    lane.ended(now_s)
    return current.source, int(current.message[:4])


def leave_all(lane):
    return [leave(lane) for _ in range(len(lane))]


def play(lane, arrivals):
    """Offer (time, source, number) each; return what left when its rate let it."""
    departures = []
    for (now_s, source, number), (next_s, *_) in pairwise([*sorted(arrivals), (math.inf,)]):
        lane.offer(b"%4d" % number, now_s, source=source)
        looked_s = now_s
        while len(lane) and (due_s := lane.due_s(looked_s)) < next_s:
            looked_s = due_s
            departures.append((due_s, *leave(lane, due_s)))
    return departures


def every(rate_hz, source, for_s=20.0):
    return [(number / rate_hz, source, number) for number in range(int(rate_hz * for_s))]


@given(st.lists(st.sampled_from("abc"), min_size=1, max_size=20))
def test_the_newest_of_each_source_leaves_in_the_turn_of_the_first(sources):
    """While it waits, a sample is replaced by the newest of its source, which keeps the turn."""
    lane = make()
    for number, source in enumerate(sources):
        lane.offer(b"%4d" % number + LARGE, 0.0, source=source)
    newest = {source: number for number, source in enumerate(sources)}
    assert leave_all(lane) == list(newest.items())
    assert lane.withheld.total() == len(sources) - len(newest)


@given(st.integers(2, 4), st.lists(st.one_of(st.none(), st.tuples(st.sampled_from("abc"), st.booleans())), max_size=40))
def test_an_ordered_topic_keeps_its_order_and_counts_what_it_drops(depth, steps):
    """Its sources leave in the order they came; each sample has left, is among the newest that wait, or is counted."""
    lane = make(depth=depth, is_ordered=True)
    offered, left = [], []
    for step in steps:
        if step is not None:
            source, is_large = step
            lane.offer(b"%4d" % len(offered) + is_large * LARGE, 0.0, source=source)
            offered.append((source, len(offered)))
        elif len(lane):
            left.append(leave(lane))
        assert len(lane) == min(depth, len(offered) - len(left) - lane.withheld.total())
    waiting = len(lane)
    left += leave_all(lane)
    assert left == [each for each in offered if each in left]
    assert left[len(left) - waiting :] == offered[len(offered) - waiting :]


def test_a_history_keeps_small_samples_and_the_newest_large_one():
    """A latched topic holds what late readers get: several small samples, but one map."""
    lane = Lane(lambda _sample: None, depth=2, large_depth=1)
    for number, more in enumerate([b"", b"", b"", LARGE, LARGE]):
        lane.offer(b"%4d" % number + more, 0.0, source=len(more))
    assert leave_all(lane) == [(0, 1), (len(LARGE), 4), (0, 2)]


def test_sources_that_must_be_thinned_take_turns():
    """Of three nodes on one topic at 50, 30 and 10 Hz none gets less than another one and wants more."""
    heard = Counter(source for _, source, _ in play(make(45.0), [*every(50.0, 1), *every(30.0, 2), *every(10.0, 3)]))
    assert [heard[source] for source in (1, 2, 3)] == pytest.approx([350, 350, 200], rel=0.15)


def test_of_a_source_that_alternates_both_kinds_are_heard():
    """Of two sentences in turn at 10 Hz, thinned to 5 Hz, both come, each at 1.5 Hz at least."""
    kinds = Counter(number % 2 for _, _, number in play(make(5.0), every(10.0, "gps")))
    assert kinds.total() == pytest.approx(100, abs=4)
    assert min(kinds[0], kinds[1]) >= 30


def test_a_dip_of_the_rate_costs_no_small_sample():
    """What comes in a fifth of a second of too low a rate waits and leaves later; where that lasts, the newest does."""
    plan = TopicPlan(rate_hz=100.0, min_rate_hz=0.0, deadline_ns=0, depth=1, weight=1.0, wire_bytes=500.0, packets=1)
    low = Price(share_per_weight=0.0025, capacity_bytes_per_second=1e6)
    assert low.rate_hz(plan) == 5.0
    lane = make()
    lane.retune(plan, None)
    for number in range(100):
        lane.offer(b"%4d" % number, 0.01 * number)
        leave(lane, 0.01 * number)
    lane.retune(plan, low)
    for number in range(100, 120):
        lane.offer(b"%4d" % number, 0.01 * number)
    assert (len(lane), lane.withheld.total()) == (20, 0)
    for number in range(120, 150):
        lane.offer(b"%4d" % number, 0.01 * number)
    assert [number for _, number in leave_all(lane)] == [148, 149]  # of which its rate has the credit


def test_of_a_burst_as_much_waits_as_its_configured_rate_lets_leave_soon():
    """Of 80 samples at once 60 wait where 200 a second are allowed; that rate costs the others, not the price."""
    terms = {"weight": 1.0, "wire_bytes": 500.0, "packets": 1, "max_rate_hz": 200.0}
    lane = make()
    lane.retune(
        TopicPlan(rate_hz=6.25, min_rate_hz=0.0, deadline_ns=0, depth=1, **terms),
        Price(share_per_weight=math.inf, capacity_bytes_per_second=1e6),
    )
    for _ in range(80):
        lane.offer(b"   0", 0.0)
    assert (len(lane), lane.withheld) == (60, {"rate": 20})


def test_a_burst_of_small_samples_costs_none_where_no_rate_is_set():
    """All of what is published at once leaves; where more keeps coming than leaves, ten wait."""
    lane = make()
    for burst_s in (0.0, 0.5, 2.0):
        for number in range(60):
            lane.offer(b"%4d" % number, burst_s)
        assert [number for _, number in leave_all(lane)] == [*range(60)]
    for number in range(100):
        lane.offer(b"%4d" % number, 20.0 + 0.01 * number)
    assert [number for _, number in leave_all(lane)] == [*range(90, 100)]


def test_what_has_no_rate_stays_new_where_the_link_takes_nothing():
    """A fifth of a second of that costs no sample; where it lasts, the newest waits."""
    lane = make()
    for number in range(10):
        lane.offer(b"%4d" % number, 0.02 * number, is_held_up=True)
    assert len(lane) == 10
    for number in range(10, 50):
        lane.offer(b"%4d" % number, 0.02 * number, is_held_up=True)
    assert leave_all(lane) == [(None, 49)]
    assert lane.withheld == {"blocked": 49}


@pytest.mark.parametrize("more", [1, 60])
def test_a_burst_that_leaves_slowly_keeps_no_newer_sample_waiting(more):
    """At 5 Hz a burst of 60 leaves whole if nothing follows; what follows every 2 s waits for no older one."""
    first = [(0.0, "log", 0)] * 60
    assert len(play(make(5.0), first)) == 60
    departures = play(make(5.0), first + [(float(at_s), "log", at_s) for at_s in range(2, 60, 2)] * more)
    assert max(left_s - at_s for left_s, _, at_s in departures if at_s < 58) <= 2.0


@pytest.mark.parametrize(("most_hz", "within_s"), [(math.inf, 3.5), (30.0, 11.0)])
def test_an_ordered_topic_catches_up_after_an_outage(most_hz, within_s):
    """What 5 s of an outage held up leaves faster than it comes, within the configured rate and without a burst."""
    lane = make(25.0, depth=1000, is_ordered=True)
    lane.retune(TopicPlan(rate_hz=25.0, min_rate_hz=0.0, deadline_ns=0, depth=1000, max_rate_hz=most_hz), None)
    for number in range(100):
        lane.offer(b"%4d" % number, 0.0)
    departures = play(lane, [(5.0 + number / 20.0, None, 100 + number) for number in range(400)])
    caught_up_s = next(left_s for left_s, _, number in departures if left_s - (5.0 + (number - 100) / 20.0) < 0.01)
    assert caught_up_s - 5.0 <= within_s
    assert [number for *_, number in departures] == list(range(500))
    rate_hz = min(most_hz, 50.0)
    for (one_s, *_), (nine_later_s, *_) in zip(departures, departures[9:], strict=False):
        assert nine_later_s - one_s >= (9 - 0.3 * 25.0) / rate_hz


@pytest.mark.parametrize(("most_hz", "within_s"), [(math.inf, 0.0), (4.0, 5.0)])
def test_a_latched_history_needs_no_rate_but_the_configured_one(most_hz, within_s):
    """What many writers of one topic have latched leaves as fast as the link has time to spare, within max_rate_hz."""
    lane = Lane(lambda _sample: None, depth=1000, is_kept=True)
    lane.retune(TopicPlan(rate_hz=1.0, min_rate_hz=1.0, deadline_ns=0, depth=1, max_rate_hz=most_hz), None)
    now_s = 0.0
    for source in range(20):
        lane.offer(b"%4d" % source, now_s, source=source)
    while len(lane):
        now_s = lane.spare_s(now_s)
        leave(lane, now_s)
    assert now_s <= within_s


def test_a_latched_topic_that_comes_above_its_configured_rate_stays_new():
    """Older samples give way to newer ones, so the backlog does not grow."""
    lane = Lane(lambda _sample: None, depth=1000, is_kept=True)
    lane.retune(TopicPlan(rate_hz=2.0, min_rate_hz=1.0, deadline_ns=0, depth=1, max_rate_hz=2.0), None)
    departures = play(lane, every(3.0, "a"))
    assert len(departures) >= 35
    assert max(left_s - number / 3.0 for left_s, _, number in departures) <= 0.5


def test_a_first_rate_delays_no_sample_of_a_topic_that_left_without_one():
    """What has left before a first plan costs no credit: one of two samples a second would wait 0.4 s."""
    lane = make()
    play(lane, [(number / 2, "a", number) for number in range(6)])
    lane.retune(TopicPlan(rate_hz=2.5, min_rate_hz=0.0, deadline_ns=0, depth=1), None)
    assert play(lane, [(3.0, "a", 6)]) == [(3.0, "a", 6)]


def test_what_has_expired_does_not_leave():
    """A sample older than its LIFESPAN is withheld, and the next one leaves in its place."""
    lane = make(depth=3, is_ordered=True)
    for number, expires_s in enumerate([1.0, 3.0, 2.0]):
        lane.offer(b"%4d" % number, 0.0, expires_s=expires_s)
    assert leave(lane, 2.0) == (None, 1)
    assert lane.begin(2.0) is None
    assert lane.withheld.total() == 2


def test_what_waits_is_on_its_way_or_was_just_now_is_known():
    """A large answer is not sent again while it waits or crosses, nor just after."""
    lane = make()
    assert not lane.has("answer", 0.0)
    lane.offer(b"", 0.0, source="answer")
    assert lane.has("answer", 0.0)
    lane.begin(0.0)
    assert lane.has("answer", 60.0)
    lane.ended(60.0)
    assert [lane.has("answer", at_s) for at_s in (61.0, 70.0)] == [True, False]


def test_a_plan_of_fewer_samples_leaves_the_operators_queue_as_long_as_it_is():
    """An ordered topic with a depth of its own loses nothing within it, whatever DEPTH the plan gives."""
    lane = make(depth=2, is_ordered=True, least_depth=5)
    for number in range(7):
        lane.offer(b"%4d" % number, 0.0)
    assert [number for _, number in leave_all(lane)] == [2, 3, 4, 5, 6]
