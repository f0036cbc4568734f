"""The pacer bounds the samples that leave, counts every one, and delays none without need."""

import math
from itertools import accumulate, pairwise
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from arpd.apply.endpoint.pacing import Pacer
from arpd.model.settings import Overflow

GAPS = st.lists(st.floats(0.0, 0.5), min_size=1, max_size=60)
RATES = st.floats(0.5, 500.0)
OVERFLOWS = st.sampled_from(Overflow)


def make(overflow=Overflow.LATEST, depth=10):
    withheld: list[int] = []
    return Pacer(overflow=overflow, depth=depth, on_withheld=lambda samples, _cause: withheld.append(samples)), withheld


def name(number):
    return number.to_bytes(4, "big")


def drain(pacer, now_s):
    taken = []
    while (sample := pacer.take(now_s)) is not None:
        taken.append(sample)
    return taken


def play(pacer, arrivals, *, until_s):
    """Offer a sample at each time, and take each when it is due; return (time, age) of every departure."""
    departures = []
    for number, (now_s, next_s) in enumerate(pairwise([*arrivals, until_s])):
        pacer.offer(b"%d" % number, now_s)
        looked_s = now_s
        while (due_s := pacer.due_s(looked_s)) < next_s:
            looked_s = due_s + 1e-9
            departures.append((due_s, due_s - arrivals[int(pacer.take(looked_s))]))
    return departures


@given(GAPS, st.lists(RATES, min_size=1, max_size=8), OVERFLOWS)
def test_no_window_carries_more_than_its_rate_and_one_burst(gaps, rates, overflow):
    """Between any two departures at most ∫rate + one burst of samples leaves, also when the rate changes often."""
    pacer, _ = make(overflow, depth=100)
    now_s, allowed, departures = 100.0, 0.0, []
    for number, gap_s in enumerate(gaps):
        rate_hz = rates[number % len(rates)]
        pacer.retune(rate_hz=rate_hz, depth=100, now_s=now_s)
        pacer.offer(name(number), now_s)
        departures += [allowed] * len(drain(pacer, now_s))
        now_s += gap_s
        allowed += rate_hz * gap_s
    burst = max(2.0, 0.05 * max(rates))
    for first, start in enumerate(departures):
        for last in range(first, len(departures)):
            assert last - first + 1 <= departures[last] - start + burst + 1e-6


@given(st.lists(st.tuples(st.floats(0.0, 0.3), st.booleans(), RATES, st.integers(1, 5)), max_size=60), OVERFLOWS)
def test_every_sample_is_taken_withheld_or_waiting(steps, overflow):
    """Offered = taken + withheld + waiting at any time, and samples leave in the order they came."""
    pacer, withheld = make(overflow)
    now_s, offered, taken = 100.0, 0, []
    for gap_s, publishes, rate_hz, depth in steps:
        now_s += gap_s
        if publishes:
            pacer.offer(name(offered), now_s)
            offered += 1
        else:
            pacer.retune(rate_hz=rate_hz, depth=depth, now_s=now_s)
        taken += drain(pacer, now_s)
    assert offered == len(taken) + sum(withheld) + len(pacer)
    assert all(before < after for before, after in pairwise(taken))


@given(RATES, st.lists(st.floats(0.0, 0.49), min_size=2, max_size=50))
def test_a_source_at_its_rate_is_never_delayed(rate_hz, earliness):
    """A source at exactly the paced rate that is early by less than half a period passes at once."""
    pacer, _ = make()
    pacer.retune(rate_hz=rate_hz, depth=10, now_s=0.0)
    for number, early in enumerate(earliness):
        now_s = (number + 1.0 - early) / rate_hz
        pacer.offer(name(number), now_s)
        assert pacer.take(now_s + 1e-9) == name(number)


@given(RATES, st.integers(2, 20))
def test_due_is_the_first_moment_a_sample_may_leave(rate_hz, samples):
    """Just before `due_s` nothing leaves, at `due_s` one sample does."""
    pacer, _ = make(Overflow.QUEUE, depth=100)
    pacer.retune(rate_hz=rate_hz, depth=100, now_s=0.0)
    for number in range(samples):
        pacer.offer(name(number), 0.0)
    now_s = 0.0
    for number in range(samples):
        due_s = pacer.due_s(now_s)
        if due_s > now_s:
            assert pacer.take(now_s + 0.99 * (due_s - now_s)) is None
        assert pacer.take(due_s + 1e-9) == name(number)
        now_s = due_s + 1e-9
    assert pacer.due_s(now_s) == math.inf


@given(st.floats(0.05, 0.97), st.floats(1.0, 100.0), st.integers(0, 2**32))
def test_a_conflated_sample_leaves_as_it_arrives_and_the_rate_stays(share, source_hz, seed):
    """A steady source that must give way sends only fresh samples, at the paced rate."""
    random = Random(seed)
    pacer, _ = make()
    pacer.retune(rate_hz=share * source_hz, depth=10, now_s=0.0)
    arrivals = [(number + random.uniform(0.0, 0.1)) / source_hz for number in range(400)]
    departures = play(pacer, arrivals, until_s=arrivals[-1])
    assert all(age_s == 0.0 for _, age_s in departures)
    assert len(departures) == pytest.approx(share * 400, abs=4)


@example(477.5, [0.0, 1.2e-38, 1.2e-38])
@given(RATES, GAPS)
def test_the_last_sample_leaves_whatever_came_before(rate_hz, gaps):
    """When the source stops, its newest sample leaves after a period of the rate or 1.5 of the source."""
    pacer, withheld = make()
    pacer.retune(rate_hz=rate_hz, depth=10, now_s=0.0)
    arrivals = list(accumulate(gaps))
    departures = play(pacer, arrivals, until_s=math.inf)
    assert len(departures) + sum(withheld) == len(arrivals)
    assert departures[-1][0] - departures[-1][1] == pytest.approx(arrivals[-1])
    assert departures[-1][1] <= max(1.0 / rate_hz, 1.5 * max(gaps)) + 1e-6


def test_what_waits_for_a_fresher_sample_waits_one_and_a_half_periods():
    """A source that stops while credit comes has its waiting sample sent then, not before."""
    pacer, _ = make()
    pacer.retune(rate_hz=4.0, depth=10, now_s=0.0)
    arrivals = [number / 10.0 for number in range(5)]  # the last finds credit for 0.6 samples
    sent_s, age_s = play(pacer, arrivals, until_s=math.inf)[-1]
    assert age_s == pytest.approx(0.15)
    assert sent_s == pytest.approx(arrivals[-1] + 0.15)


def test_a_sample_that_waited_out_a_pause_gives_way_to_a_fresher_one():
    """Credit from before the pause goes to the first arrival after it."""
    pacer, _ = make()
    pacer.retune(rate_hz=0.0, depth=10, now_s=0.0)
    for number in range(10):
        pacer.offer(name(number), number / 10.0)
    pacer.retune(rate_hz=5.0, depth=10, now_s=0.95)
    assert pacer.take(0.95) is None
    pacer.offer(name(10), 1.0)
    assert pacer.take(1.0) == name(10)


def test_latest_keeps_only_the_newest():
    """While paced, a newer sample replaces the one that waits, and the older one is counted."""
    pacer, withheld = make(Overflow.LATEST)
    pacer.retune(rate_hz=1.0, depth=10, now_s=0.0)
    assert pacer.admits(0.0)
    for number in range(5):
        pacer.offer(name(number), 0.0)
    assert len(pacer) == 1
    assert sum(withheld) == 4
    assert pacer.take(0.0) == name(4)


def test_queue_withholds_its_oldest_beyond_the_depth():
    """A full queue loses its oldest sample, and a smaller depth sheds at once."""
    pacer, withheld = make(Overflow.QUEUE, depth=3)
    for number in range(5):
        pacer.offer(name(number), 0.0)
    assert sum(withheld) == 2
    pacer.retune(rate_hz=10.0, depth=1, now_s=0.0)
    assert sum(withheld) == 4
    assert pacer.take(0.0) == name(4)


@pytest.mark.parametrize("overflow", Overflow)
def test_unpaced_samples_leave_at_once_and_waiting_ones_are_kept(overflow):
    """Without a rate samples are due at once, and those that wait for the writing thread are kept up to the depth."""
    pacer, withheld = make(overflow, depth=4)
    for number in range(4):
        pacer.offer(name(number), 0.0)
    assert not withheld
    assert drain(pacer, 0.0) == [name(number) for number in range(4)]


def test_paced_samples_that_are_due_do_not_replace_each_other():
    """A burst that has its credit waits for the writing thread whole; what comes beyond it drives the oldest out."""
    pacer, withheld = make()
    pacer.retune(rate_hz=100.0, depth=10, now_s=0.0)  # with time, credit for five
    for number in range(5):
        pacer.offer(name(number), 1.0)
    assert not withheld
    pacer.offer(name(5), 1.0)
    assert withheld == [1]
    assert drain(pacer, 1.0) == [name(number) for number in range(1, 6)]


def test_a_paused_topic_waits_without_end_and_resumes():
    """At rate 0 nothing is ever due; with a rate again the sample leaves within one period."""
    pacer, _ = make()
    pacer.retune(rate_hz=0.0, depth=10, now_s=0.0)
    pacer.offer(name(0), 0.0)
    assert pacer.due_s(0.0) == math.inf
    assert pacer.take(1e6) is None
    pacer.retune(rate_hz=2.0, depth=10, now_s=1e6)
    assert pacer.due_s(1e6) <= 1e6 + 0.5


def test_a_price_that_repeats_does_not_restart_the_schedule():
    """Retuning to the same rate ten times a second neither releases early nor keeps a sample back."""
    pacer, _ = make()
    pacer.retune(rate_hz=1.0, depth=10, now_s=0.0)
    pacer.offer(name(0), 0.0)
    drain(pacer, 0.0)
    departures = []
    for tick in range(100):
        now_s = tick / 10
        pacer.retune(rate_hz=1.0, depth=10, now_s=now_s)
        pacer.offer(name(tick), now_s)
        departures += [now_s] * len(drain(pacer, now_s))
    assert len(departures) in (9, 10)


def test_clear_counts_what_it_gives_up():
    """Samples that wait at the end count as withheld."""
    pacer, withheld = make(Overflow.QUEUE)
    pacer.offer(name(0), 0.0)
    pacer.offer(name(1), 0.0)
    pacer.clear()
    pacer.clear()
    assert withheld == [2]
    assert not len(pacer)


@given(
    st.lists(st.tuples(st.booleans(), st.sampled_from([0.0, 0.001, 0.03, 0.2])), max_size=60), st.sampled_from(Overflow)
)
def test_admitting_is_queueing_and_taking(steps, overflow):
    """An admitted sample is one that would have been taken at once, for the same credit."""
    (one, _), (other, _) = make(overflow, depth=3), make(overflow, depth=3)
    now_s = 0.0
    for pacer in (one, other):
        pacer.retune(rate_hz=20.0, depth=3, now_s=now_s)
    for number, (is_drained, wait_s) in enumerate(steps):
        now_s += wait_s
        if is_drained:
            assert drain(one, now_s) == drain(other, now_s)
        admitted = one.admits(now_s)
        if not admitted:
            one.offer(name(number), now_s)
        was_empty = not len(other)
        other.offer(name(number), now_s)
        assert admitted == (was_empty and other.due_s(now_s) <= now_s)
        if admitted:
            assert other.take(now_s) == name(number)
        assert one.due_s(now_s) == other.due_s(now_s)
