"""Probes within their share of the link: pings always, trains when there is something to buy with what was saved."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.probes import ProbeParameters, ProbeSchedule
from arpd.model.wire import probe_wire_bytes

TUNING = ProbeParameters()
MBIT = 125_000.0  # bytes/s
CALM = {
    "is_measured": True,
    "is_out": False,
    "is_free": True,
    "is_urgent": False,
    "surprise_bytes_per_second": None,
    "needs_pair": False,
    "copies": 1,
}
CAPACITIES = st.floats(0.2 * MBIT, 200 * MBIT)


class Probing:
    """A schedule that is asked at every tick, and everything it sent: when, and what."""

    def __init__(self, capacity=20 * MBIT, *, tick_s=0.1, **options):
        self.schedule = ProbeSchedule(TUNING)
        self.now_s = 800.0
        self.tick_s = tick_s
        self.options = CALM | {"capacity_bytes_per_second": capacity} | options
        self.sent = []

    def run(self, duration_s, **changes):
        """Return what is sent meanwhile; the changes stay."""
        self.options |= changes
        before = len(self.sent)
        for _ in range(round(duration_s / self.tick_s)):
            self.now_s += self.tick_s
            self.sent += [(self.now_s, request) for request in self.schedule.wanted(self.now_s, **self.options)]
        return self.sent[before:]

    def known(self):
        """Get over the first trains."""
        self.run(4 * TUNING.first_s, is_measured=False)
        self.options["is_measured"] = True
        return self


def cost(sent, *, copies=1):
    """Return what probes put on the link, with the reports that answer the pings (bytes)."""
    return copies * sum(
        request.packets * probe_wire_bytes(request.packet_bytes) + (request.packets == 1) * TUNING.report_bytes
        for _, request in sent
    )


def trains(sent):
    return [request for _, request in sent if request.packets > 1]


def allowed(capacity, *, copies=1):
    """Return the share of a capacity, or what the rarest pings and trains cost where that is more (bytes/s)."""
    pings = (probe_wire_bytes(TUNING.ping_bytes) + TUNING.report_bytes) / TUNING.ping_most_s
    trains = TUNING.train_least_packets * probe_wire_bytes(TUNING.packet_bytes) / TUNING.train_most_s
    return max(TUNING.share * capacity, copies * (pings + trains) + 0.1 * TUNING.share * capacity)


@settings(deadline=None, max_examples=40)
@given(CAPACITIES, st.integers(1, 4), st.floats(0.05, 0.4), st.booleans(), st.booleans())
def test_a_minute_costs_its_share(capacity, copies, tick_s, is_urgent, is_surprised):
    """Pings, trains and reports together, to every peer, on any link and whatever is expected of it."""
    probing = Probing(capacity, tick_s=tick_s, copies=copies).known()
    sent = probing.run(60.0, is_urgent=is_urgent, surprise_bytes_per_second=1.5e6 if is_surprised else None)
    # Two trains for what was saved before this minute, a little for those of small packets.
    largest = max(cost([each], copies=copies) for each in sent)
    assert cost(sent, copies=copies) <= 1.02 * 60.0 * allowed(capacity, copies=copies) + 2 * largest


@settings(deadline=None, max_examples=20)
@given(CAPACITIES, st.floats(1.0, 8.0))
def test_a_long_calm_is_not_saved_up_for_ever(capacity, urgent_s):
    """After ten quiet minutes urgent trains have no more to spend than a few seconds' budget, or a few trains."""
    probing = Probing(capacity, tick_s=0.4).known()
    probing.run(600.0)
    probing.tick_s = 0.1
    sent = probing.run(urgent_s, is_urgent=True, surprise_bytes_per_second=1.5e6)
    largest = max(cost([each]) for each in sent)
    assert cost(sent) <= allowed(capacity) * (urgent_s + TUNING.saved_s) + 4 * largest


@pytest.mark.parametrize("blocked", [{"is_out": True}, {"is_free": False}])
@settings(deadline=None, max_examples=20)
@given(capacity=CAPACITIES, is_measured=st.booleans(), is_urgent=st.booleans())
def test_no_train_goes_where_it_would_only_wait(blocked, capacity, is_measured, is_urgent):
    """While the link is out or a queue stands there are pings, and no trains, however much they are wanted."""
    probing = Probing(capacity).known()
    options = {
        "is_measured": is_measured,
        "is_urgent": is_urgent,
        "surprise_bytes_per_second": 1.5e6 if is_urgent else None,
        "needs_pair": True,
    }
    sent = probing.run(20.0, **options, **blocked)
    assert sent
    assert not trains(sent)


def test_an_outage_is_pinged_rarely_and_with_substance():
    """Two larger packets a second find out whether the link is back."""
    sent = Probing().known().run(20.0, is_out=True)
    assert len(sent) == pytest.approx(20.0 / TUNING.outage_ping_s, abs=1)
    assert {request.packet_bytes for _, request in sent[1:]} == {TUNING.outage_ping_bytes}


@settings(deadline=None, max_examples=30)
@given(CAPACITIES, st.integers(1, 4), st.floats(0.02, 0.3))
def test_pings_keep_their_distance(capacity, copies, tick_s):
    """Never closer than the least time between two, and never further apart than the most, up to a tick."""
    pings = [
        at_s for at_s, request in Probing(capacity, tick_s=tick_s, copies=copies).run(10.0) if request.packets == 1
    ]
    gaps = [after - before for before, after in pairwise(pings)]
    assert min(gaps) >= TUNING.ping_s - 1e-9
    assert max(gaps) <= TUNING.ping_most_s + tick_s + 1e-9


def test_a_fast_link_is_pinged_at_every_tick():
    """Where a ping costs next to nothing the queue is looked at ten times a second."""
    assert len(Probing(20 * MBIT).run(10.0)) >= 100


@pytest.mark.parametrize("mbit", [0.2, 1.0, 20.0, 200.0])
def test_the_first_trains_do_not_wait_for_savings(mbit):
    """Before anything is known of a link three trains go within a second, of at least a few packets."""
    sent = trains(Probing(mbit * MBIT, is_measured=False).run(1.0))
    assert len(sent) >= 3
    assert min(request.packets for request in sent) >= TUNING.train_least_packets


def test_urgent_trains_spend_what_calm_ones_saved():
    """After some calm, a doubt buys several trains within a few seconds, and a surprise one at once."""
    calm = Probing().known()
    calm.run(30.0)
    before = len(trains(calm.run(3.0)))
    assert len(trains(calm.run(3.0, is_urgent=True))) >= before + 3
    surprised = Probing().known()
    surprised.run(30.0)
    last_s = max(at_s for at_s, request in surprised.sent if request.packets > 1)
    surprised.run(3.0)
    surprised.run(0.2, surprise_bytes_per_second=1.5e6)
    assert len([at_s for at_s, request in surprised.sent if request.packets > 1 and at_s > last_s + 3.0]) >= 1


def test_what_was_saved_on_a_better_link_buys_trains_on_a_worse_one():
    """Right after a deep fall several trains look whether it lasts, before the small budget of now could pay one."""
    probing = Probing(20 * MBIT).known()
    probing.run(30.0)
    sent = probing.run(3.0, capacity_bytes_per_second=1 * MBIT, is_urgent=True)
    assert len(trains(sent)) >= 4
    assert cost(sent) > 3.0 * allowed(1 * MBIT)


def test_a_train_is_as_long_as_the_link_is_fast():
    """Enough packets to last, on the slowest link a few, and never more than a receiver can take."""
    first = [trains(Probing(mbit * MBIT, is_measured=False).run(0.5))[0] for mbit in (0.2, 5, 10, 20, 50, 200)]
    sizes = [request.packets for request in first]
    assert sizes == sorted(sizes)
    assert (sizes[0], sizes[-1]) == (TUNING.train_least_packets, TUNING.train_most_packets)


def test_small_packets_follow_large_ones():
    """Where the overhead is not known yet every large train has a small one right behind it."""
    sent = [each for each in Probing(needs_pair=True).known().run(30.0) if each[1].packets > 1]
    sizes = [request.packet_bytes for _, request in sent]
    assert sizes[:20:2] == [TUNING.packet_bytes] * 10 or sizes[1:21:2] == [TUNING.packet_bytes] * 10
    for (large_s, _), (small_s, request) in pairwise(sent):
        if request.packet_bytes == TUNING.small_packet_bytes:
            assert small_s - large_s == pytest.approx(TUNING.pair_s, abs=0.1)


def test_small_packets_are_rare_once_the_overhead_is_known():
    """It is looked at again now and then, for a radio changes its ways."""
    sent = trains(Probing().known().run(120.0))
    assert 1 <= sum(request.packet_bytes == TUNING.small_packet_bytes for request in sent) <= len(sent) // 5


def test_numbers_count_up():
    """Every probe has a number of its own, in the order in which they leave."""
    numbers = [request.number for _, request in Probing().known().run(30.0, is_urgent=True)]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.parametrize("mbit", [0.2, 0.8, 3.0])
@pytest.mark.parametrize("copies", [1, 4])
def test_even_the_slowest_link_is_looked_at_now_and_then(mbit, copies):
    """Who never sends a train never learns that the link has become better, whatever a train costs."""
    sent = Probing(mbit * MBIT, copies=copies).known().run(60.0)
    times = [at_s for at_s, request in sent if request.packets > 1]
    assert len(times) >= 60.0 // TUNING.train_most_s
    assert max(after - before for before, after in pairwise(times)) <= TUNING.train_most_s + 0.5


def test_a_ping_says_how_rare_reports_may_be():
    """Where pings are rare, so may be the reports that nothing calls for, and never as rare as an outage is long."""
    slow, fast = (Probing(mbit * MBIT).known().run(5.0)[-1][1].quiet_s for mbit in (0.2, 20.0))
    assert slow > fast
    assert slow >= TUNING.ping_most_s


@pytest.mark.parametrize("mbit", [1.5, 3, 5, 10, 50])
@pytest.mark.parametrize("is_urgent", [False, True])
def test_a_minute_costs_its_share_with_small_trains_too(mbit, is_urgent):
    """While the overhead is not known small trains follow large ones, out of the same purse."""
    probing = Probing(mbit * MBIT, needs_pair=True).known()
    sent = probing.run(60.0, is_urgent=is_urgent)
    assert cost(sent) <= 1.02 * 60.0 * allowed(mbit * MBIT) + max(6_000, 0.02 * mbit * MBIT)
