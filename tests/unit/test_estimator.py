"""The estimator's rules, one by one, and what no evidence whatever may make it say."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimator import Estimator, EstimatorTuning
from arpd.interface import InterfaceState, LinkCounters
from arpd.model import MOST_YIELDED, CapacityKind, LinkState, MemoryState, Observation
from arpd.probing import PeerReport, Train
from arpd.settings import LinkSettings
from arpd.wire import probe_wire_bytes

TUNING = EstimatorTuning()
FIRST = 2.0e6
UP = LinkCounters(
    interface="w", rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=InterfaceState.UP
)


class Link:
    """Feeds an estimator a tick every 100 ms, with one report each unless it is silent."""

    def __init__(self, **link):
        self.estimator = Estimator(LinkSettings(initial_capacity_bytes_per_second=FIRST, **link))
        self.now_s = 500.0
        self.probes = []

    def tick(self, *, rate=1e5, delay_s=0.02, trains=(), silent=False, counters=UP, peer="p", peers=None, clock_s=0.0):
        self.now_s += 0.1
        report = PeerReport(
            peer=peer,
            received_at_s=self.now_s,
            interval_s=0.1,
            rx_bytes=round(rate * 0.1),
            rx_packets=10,
            delays_s=(delay_s + clock_s,),
            trains=tuple(Train(payload_bytes=round(c), duration_s=1.0, packets=10) for c in trains),
            # A ping that waits in a queue has not arrived yet; one that has not is not reported.
            last_probe=self.probes[-1].number if self.probes and delay_s < 0.1 else 0,
        )
        estimate = self.estimator.update(
            Observation(
                now_s=self.now_s,
                counters=counters,
                reports=() if silent else (report,),
                publishers=(),
                memory=MemoryState(total_bytes=1, available_bytes=1),
                sensing_topics=0,
                actuation_topics=0,
                peers=peers,
            )
        )
        self.probes += self.estimator.wanted_probes(self.now_s)
        return estimate

    def ticks(self, count, **kwargs):
        for _ in range(count):
            estimate = self.tick(**kwargs)
        return estimate

    def measured(self, capacity=FIRST):
        """Bring it to a measured capacity."""
        self.ticks(12)
        for _ in range(3):
            estimate = self.tick(trains=[capacity])
        assert estimate.kind is CapacityKind.PEER
        return self


def test_before_evidence_it_says_what_it_was_told():
    """The first belief is the configured one, and it is called that."""
    link = Link()
    estimate = link.tick()
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.kind is CapacityKind.CONFIGURED
    assert not link.estimator.has_evidence


def test_three_trains_are_the_first_evidence():
    """The median of three trains replaces the configured belief at once, upwards or downwards."""
    link = Link()
    link.tick(trains=[4e6])
    assert link.tick(trains=[5e6]).kind is CapacityKind.CONFIGURED
    estimate = link.tick(trains=[9e6])
    assert estimate.kind is CapacityKind.PEER
    assert estimate.capacity_bytes_per_second == 5e6
    assert link.estimator.has_evidence


def test_without_any_peer_a_plan_may_follow_after_a_while():
    """Nobody who measures must not mean that nobody plans."""
    link = Link()
    link.ticks(29, silent=True)
    assert not link.estimator.has_evidence
    link.ticks(3, silent=True)
    assert link.estimator.has_evidence


def test_a_standing_queue_makes_delivery_the_capacity():
    """Two reports of a high delay, and what arrives is what the link carries."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    assert link.tick(rate=5e5, delay_s=0.3).capacity_bytes_per_second == FIRST
    estimate = link.tick(rate=5e5, delay_s=0.4)
    assert estimate.capacity_bytes_per_second == pytest.approx(5e5, rel=0.01)
    assert estimate.state is LinkState.DRAINING
    assert estimate.queue_delay_s == pytest.approx(0.38)


def test_one_late_report_is_no_queue():
    """A single delayed ping changes nothing."""
    link = Link().measured()
    link.tick(rate=5e5, delay_s=0.4)
    assert link.tick(rate=5e5).capacity_bytes_per_second == FIRST


def test_a_queue_at_full_delivery_is_no_fall():
    """While the link delivers what is believed, a queue says that too much was sent, not that the link is worse."""
    link = Link().measured()
    link.ticks(4, rate=0.97 * FIRST)
    estimate = link.ticks(5, rate=0.97 * FIRST, delay_s=0.3)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.state is LinkState.CONGESTED


def test_low_throughput_alone_is_no_fall():
    """An idle link shows demand, not capacity."""
    estimate = Link().measured().ticks(50, rate=1e3)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.is_app_limited


def test_trains_undo_a_fall_they_contradict():
    """A short disturbance must not cost the half minute that growing back takes."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    link.ticks(3, rate=5e5, delay_s=0.3)
    link.ticks(2, rate=5e5)
    link.tick(trains=[0.95 * FIRST])
    estimate = link.tick(trains=[0.95 * FIRST])
    assert estimate.capacity_bytes_per_second == pytest.approx(TUNING.undo_to * FIRST)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(1e4, 1e8), min_size=10, max_size=60))
def test_it_never_moves_faster_than_half_per_second(trains):
    """Whatever trains see, a measured capacity follows them by at most the step allowed, in both directions."""
    link = Link().measured()
    before = FIRST
    for train in trains:
        after = link.tick(trains=[train]).capacity_bytes_per_second
        assert before * (1 - 0.0501) <= after <= before * (1 + 0.0501)
        before = after


def test_silence_is_an_outage_and_no_capacity():
    """After 400 ms without a report the link is out; the belief stays."""
    link = Link().measured()
    assert link.ticks(3, silent=True).state is not LinkState.OUTAGE
    estimate = link.ticks(2, silent=True)
    assert estimate.state is LinkState.OUTAGE
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.delivery_rate_bytes_per_second == 0.0


def test_after_an_outage_it_resumes_below_what_it_knew():
    """The link that returns may be another one: resume near 0.6 of the old belief."""
    link = Link().measured()
    link.ticks(30, silent=True)
    assert link.tick().capacity_bytes_per_second == pytest.approx(TUNING.resume_ratio * FIRST)


def test_a_short_silence_forgets_nothing():
    """Less than a second without reports is a hiccup."""
    link = Link().measured()
    link.ticks(6, silent=True)
    assert link.tick().capacity_bytes_per_second == FIRST


def test_in_an_outage_only_rare_pings_are_sent():
    """No train loads a link that is gone."""
    link = Link().measured()
    link.ticks(10, silent=True)
    link.probes.clear()
    link.ticks(40, silent=True)
    assert all(probe.packets == 1 for probe in link.probes)
    assert 7 <= len(link.probes) <= 9


def test_a_pinned_capacity_is_believed_and_nothing_is_probed():
    """Who pins the capacity wants no traffic for measuring it."""
    link = Link(capacity_bytes_per_second=3e6)
    estimate = link.ticks(20, trains=[1e6])
    assert estimate.capacity_bytes_per_second == 3e6
    assert estimate.kind is CapacityKind.CONFIGURED
    assert link.estimator.has_evidence
    assert not link.probes


@settings(deadline=None, max_examples=30)
@given(st.floats(5e4, 1e8))
def test_trains_cost_at_most_their_share(capacity):
    """Over a minute the trains of a measured link stay within one percent of it, and are a second apart."""
    link = Link().measured(capacity)
    link.probes.clear()
    link.ticks(600, trains=[capacity])
    trains = [probe for probe in link.probes if probe.packets > 1]
    spent = sum((probe.packets - 1) * probe.packet_bytes for probe in trains)
    largest = max(probe.packets * probe.packet_bytes for probe in trains)
    # Sizes are rounded up to whole packets, and the window cuts at most one train.
    assert spent <= 0.01 * capacity * 60 * 1.15 + largest
    assert len(trains) <= 61


def test_a_queue_stops_the_trains():
    """A train into a standing queue would measure nothing and make it longer."""
    link = Link().measured()
    link.ticks(3, rate=5e5, delay_s=0.3)
    link.probes.clear()
    link.ticks(30, rate=5e5, delay_s=0.3)
    assert all(probe.packets == 1 for probe in link.probes)


TICKS = st.lists(
    st.fixed_dictionaries(
        {
            "rate": st.floats(0.0, 1e8),
            "delay_s": st.floats(0.0, 2.0),
            "trains": st.lists(st.floats(1.0, 1e8), max_size=3),
            "silent": st.booleans(),
        }
    ),
    max_size=60,
)


@settings(deadline=None)
@given(TICKS)
def test_whatever_comes_the_estimate_is_a_capacity(ticks):
    """Positive, finite, of a known age, and never above what was believed, configured or seen."""
    link = Link()
    highest = FIRST
    for tick in ticks:
        estimate = link.tick(**tick)
        highest = max([highest, tick["rate"], *tick["trains"]])
        assert 0 < estimate.capacity_bytes_per_second <= highest * 1.01
        assert estimate.queue_delay_s >= 0
        assert 0 <= estimate.age_s < math.inf


@settings(deadline=None)
@given(TICKS, st.sampled_from([-1e6, -3.5, 0.25, 1e6]))
def test_the_peers_clock_does_not_matter(ticks, offset_s):
    """One-way delays count only above their minimum, so any offset gives the same course."""
    here, there = Link(), Link()
    for tick in ticks:
        one = here.tick(**tick)
        other = there.tick(**tick, clock_s=offset_s)
        assert other.capacity_bytes_per_second == pytest.approx(one.capacity_bytes_per_second)
        assert other.state == one.state


def test_alone_a_local_queue_shows_the_capacity():
    """Without a peer, what leaves while the interface drops is the best there is, and it is called local."""
    link = Link()
    sent = 0
    for step in range(130):
        sent += 30_000
        counters = replace(UP, tx_bytes=sent, tx_dropped=step)
        estimate = link.tick(silent=True, counters=counters)
    assert estimate.kind is CapacityKind.CONFIGURED or estimate.kind is CapacityKind.LOCAL
    assert estimate.capacity_bytes_per_second == pytest.approx(300_000, rel=0.02)


@pytest.mark.parametrize("counters", [None, replace(UP, state=InterfaceState.DOWN)])
def test_alone_without_an_interface_is_an_outage(counters):
    """No peer and no carrier: there is no link."""
    assert Link().ticks(5, silent=True, counters=counters).state is LinkState.OUTAGE


def test_a_peer_that_leaves_takes_its_queue_along():
    """When nobody measures the queue any more, its last length does not go on as an estimate."""
    link = Link().measured()
    link.ticks(3, delay_s=0.5, rate=5e5)
    estimate = link.ticks(30, silent=True, peers=0)
    assert estimate.queue_delay_s == 0.0
    assert estimate.kind is CapacityKind.LOCAL
    assert estimate.state is not LinkState.OUTAGE


def test_pinning_the_capacity_forgets_the_queue():
    """An operator who pins the capacity on a congested link is not left with the queue of that moment."""
    link = Link().measured()
    link.ticks(3, delay_s=0.5, rate=5e5)
    link.estimator.reconfigure(LinkSettings(capacity_bytes_per_second=1e6))
    assert link.tick(silent=True).queue_delay_s == 0.0


def test_a_silent_peer_that_is_there_is_waited_for():
    """With a peer in the graph the first plan waits longer than without one."""
    link = Link()
    link.ticks(60, silent=True, peers=1)
    assert not link.estimator.has_evidence
    link.ticks(50, silent=True, peers=1)
    assert link.estimator.has_evidence


def test_a_reloaded_first_belief_is_believed():
    """Before any evidence the configured capacity is the estimate, also after a reload."""
    link = Link()
    link.estimator.reconfigure(LinkSettings(initial_capacity_bytes_per_second=1e5))
    assert link.tick().capacity_bytes_per_second == 1e5


def test_a_second_peer_is_not_mixed_in():
    """Delays of two hosts have two clock offsets: only one of them is listened to."""
    link = Link().measured()
    for _ in range(20):
        link.tick()
        estimate = link.tick(peer="q", clock_s=5.0)
    assert estimate.queue_delay_s < 0.01


def test_a_step_of_the_peers_clock_is_no_queue():
    """A one-way delay that jumps while the round trip does not is the clock's doing."""
    link = Link().measured()
    for _ in range(5):
        assert link.tick(clock_s=7.0).queue_delay_s < 0.3


def test_foreign_traffic_is_taken_from_what_is_available_only():
    """The capacity is the whole link's; what others carry on it is told beside it."""
    link = Link().measured()
    for step in range(60):
        estimate = link.tick(counters=replace(UP, tx_bytes=round(step * 0.1 * 5e5)))
    assert estimate.capacity_bytes_per_second == FIRST
    assert 4.2e5 < estimate.foreign_bytes_per_second < 5e5
    assert estimate.available_bytes_per_second == FIRST - estimate.foreign_bytes_per_second


def test_a_pinned_capacity_is_shared_with_foreign_traffic():
    """What is pinned is what the link carries, not what of it is left."""
    link = Link(capacity_bytes_per_second=3e6)
    for step in range(60):
        estimate = link.tick(counters=replace(UP, tx_bytes=round(step * 0.1 * 5e5)))
    assert estimate.available_bytes_per_second == 3e6 - estimate.foreign_bytes_per_second < 3e6 - 4.2e5


@given(st.floats(0.0, 1e9), st.floats(0.0, 1e9))
def test_at_most_half_is_yielded(capacity, foreign):
    """However much others carry, half of the capacity stays available."""
    estimate = replace(Link().tick(), capacity_bytes_per_second=capacity, foreign_bytes_per_second=foreign)
    assert MOST_YIELDED * capacity <= estimate.available_bytes_per_second <= capacity


def test_its_own_probes_are_not_foreign():
    """The trains of the first seconds, which are many and large, are known to be ours."""
    link = Link()
    for _ in range(60):
        sent = sum(probe.packets * probe_wire_bytes(probe.packet_bytes) for probe in link.probes)
        estimate = link.tick(counters=replace(UP, tx_bytes=sent), peers=1)
        assert estimate.foreign_bytes_per_second == 0.0
    assert sent > 6 * 40_000
