"""The estimator's rules, one by one, and what no evidence whatever may make it say."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.estimator import Estimator
from arpd.estimate.parameters import EstimatorParameters
from arpd.model.interface import InterfaceState, LinkCounters
from arpd.model.link import MOST_YIELDED, CapacityKind, EstimatorEvent, LinkState
from arpd.model.observation import MemoryState, Observation
from arpd.model.probing import PeerReport, Train
from arpd.model.settings import LinkSettings
from arpd.model.wire import probe_wire_bytes

TUNING = EstimatorParameters()
FIRST = 2.0e6
UP = LinkCounters(
    interface="w", rx_bytes=0, tx_bytes=0, rx_packets=0, tx_packets=0, tx_dropped=0, state=InterfaceState.UP
)


SIZE, PACKETS = 14_900, 10  # bytes of a train and the packets they are in


def seen(capacity):
    """Return a train that saw this capacity."""
    return Train(payload_bytes=SIZE, duration_s=SIZE / capacity, packets=PACKETS)


class Link:
    """Feeds an estimator: probes leave every 100 ms, and 10 ms later there is a report unless it is silent."""

    def __init__(self, **link):
        self.estimator = Estimator(LinkSettings(initial_capacity_bytes_per_second=FIRST, **link))
        self.now_s = 500.0
        self.probes = []  # when they left, and what they were
        self.arrived = 0  # the last of them

    def tick(
        self,
        *,
        rate=1e5,
        delay_s=0.02,
        trains=(),
        silent=False,
        counters=UP,
        peer="p",
        peers=None,
        clock_s=0.0,
        radio=None,
        publishers=(),
        interval_s=0.1,
        return_delay_s=None,
    ):
        observation = Observation(
            now_s=self.now_s + 0.09,
            counters=counters,
            reports=(),
            publishers=publishers,
            memory=MemoryState(total_bytes=1, available_bytes=1),
            sensing_topics=0,
            actuation_topics=0,
            peers=peers,
            radio_bytes_per_second=radio,
        )
        self.estimator.update(observation)
        self.probes += [(observation.now_s, each) for each in self.estimator.wanted_probes(observation.now_s)]
        self.now_s += 0.1
        # What waits in a queue has not arrived yet; what was lost in an outage never will.
        before, due_s = self.arrived, self.now_s - delay_s + 0.02
        if not silent:
            self.arrived = max([before, *(each.number for at_s, each in self.probes if at_s < due_s)])
        report = PeerReport(
            peer=peer,
            received_at_s=self.now_s,
            interval_s=interval_s,
            rx_bytes=round(rate * interval_s),
            rx_packets=10,
            delays_s=(delay_s + clock_s,) if self.arrived > before else (),
            trains=tuple(train if isinstance(train, Train) else seen(train) for train in trains),
            last_probe=self.arrived,
            probe_packets=sum(each.packets for _, each in self.probes if each.number < self.arrived),
            return_delay_s=return_delay_s,
        )
        return self.estimator.update(replace(observation, now_s=self.now_s, reports=() if silent else (report,)))

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
    link.ticks(28, silent=True)
    assert not link.estimator.has_evidence
    link.ticks(3, silent=True)
    assert link.estimator.has_evidence


def test_a_standing_queue_makes_delivery_the_capacity():
    """Two reports of a high delay, and what arrives is what the link carries."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    # For 300 ms no ping comes through, and then one.
    assert link.ticks(4, rate=5e5, delay_s=0.3).capacity_bytes_per_second == FIRST
    estimate = link.tick(rate=5e5, delay_s=0.3)
    assert estimate.capacity_bytes_per_second == pytest.approx(5e5, rel=0.01)
    assert estimate.state is LinkState.DRAINING
    assert estimate.queue_delay_s == pytest.approx(0.28, abs=0.05)


def test_one_late_report_is_no_queue():
    """A single delayed ping changes nothing."""
    link = Link().measured()
    link.ticks(4, rate=5e5, delay_s=0.3)
    assert link.ticks(5, rate=5e5).capacity_bytes_per_second == FIRST


def test_a_queue_at_full_delivery_is_no_fall():
    """While the link delivers what is believed, a queue says that too much was sent, not that the link is worse."""
    link = Link().measured()
    link.ticks(4, rate=0.97 * FIRST)
    estimate = link.ticks(10, rate=0.97 * FIRST, delay_s=0.3)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.state is LinkState.CONGESTED


def test_low_throughput_alone_is_no_fall():
    """An idle link shows demand, not capacity."""
    estimate = Link().measured().ticks(50, rate=1e3)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.is_app_limited


def fallen():
    """Return a link that fell from `FIRST` to a quarter of it just now, and whose queue is gone."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    link.ticks(6, rate=5e5, delay_s=0.3)
    link.ticks(2, rate=5e5)
    return link


def test_trains_undo_a_fall_they_contradict():
    """A short disturbance must not cost the half minute that growing back takes: two trains take it back."""
    link = fallen()
    assert link.tick(trains=[0.97 * FIRST]).capacity_bytes_per_second < 0.3 * FIRST
    estimate = link.tick(trains=[0.95 * FIRST])
    assert estimate.capacity_bytes_per_second == pytest.approx(0.95 * FIRST)
    assert "contradict" in estimate.evidence


def test_a_fall_is_undone_once():
    """What was before the last fall but one is long gone."""
    link = fallen()
    link.ticks(2, trains=[0.95 * FIRST])
    estimate = link.ticks(20, trains=[0.9 * FIRST])
    assert "contradict" not in estimate.evidence
    assert estimate.capacity_bytes_per_second == pytest.approx(0.9 * FIRST, rel=0.1)


def test_one_train_undoes_nothing():
    """A single reading is no evidence against a queue that stood."""
    link = fallen()
    link.tick(trains=[FIRST])
    assert link.ticks(30).capacity_bytes_per_second < 0.3 * FIRST


def test_what_two_trains_agree_on_is_followed_at_once():
    """A link that became much better is used within two trains, with a little caution."""
    link = Link().measured()
    assert link.tick(trains=[4 * FIRST]).capacity_bytes_per_second == FIRST
    estimate = link.tick(trains=[5 * FIRST])
    assert estimate.capacity_bytes_per_second == pytest.approx(TUNING.caution * 4 * FIRST)
    assert "two trains" in estimate.evidence


def test_two_trains_far_apart_do_not_agree():
    """What was seen long ago confirms nothing."""
    link = Link().measured()
    link.tick(trains=[4 * FIRST])
    link.ticks(round(TUNING.agree_window_s / 0.1) + 1)
    assert link.tick(trains=[4 * FIRST]).capacity_bytes_per_second < 1.2 * FIRST


def test_one_low_train_is_no_fall():
    """Somebody's message in between makes a train read low, and nothing makes it read high."""
    link = Link().measured()
    for train in [FIRST, 0.3 * FIRST, FIRST, FIRST, 0.5 * FIRST, FIRST]:
        estimate = link.tick(trains=[train])
    assert estimate.capacity_bytes_per_second == FIRST


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(1e4, 1e8), min_size=10, max_size=60))
def test_trains_move_it_no_faster_than_they_may(trains):
    """Without a queue it falls by a bounded part per second, and rises as slowly or to what two trains agree on."""
    link = Link().measured()
    step = 0.1 * TUNING.climb_per_second * 1.001
    before, last = FIRST, FIRST
    for train in trains:
        after = link.tick(trains=[train]).capacity_bytes_per_second
        assert before * (1 - step) <= after <= max(before * (1 + step), min(train, last))
        before, last = after, train


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
    assert all(probe.packets == 1 for _, probe in link.probes)
    assert 7 <= len(link.probes) <= 9


def test_a_pinned_capacity_is_believed_and_nothing_is_probed():
    """Who pins the capacity wants no traffic for measuring it."""
    link = Link(capacity_bytes_per_second=3e6)
    estimate = link.ticks(20, trains=[1e6])
    assert estimate.capacity_bytes_per_second == 3e6
    assert estimate.kind is CapacityKind.CONFIGURED
    assert link.estimator.has_evidence
    assert not link.probes


def test_a_queue_stops_the_trains():
    """A train into a standing queue would measure nothing and make it longer."""
    link = Link().measured()
    link.ticks(3, rate=5e5, delay_s=0.3)
    link.probes.clear()
    link.ticks(30, rate=5e5, delay_s=0.3)
    assert all(probe.packets == 1 for _, probe in link.probes)


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
    assert estimate.kind is CapacityKind.LOCAL
    assert estimate.capacity_bytes_per_second == pytest.approx(300_000, rel=0.02)
    assert "local queue" in estimate.evidence


@pytest.mark.parametrize("counters", [None, replace(UP, state=InterfaceState.DOWN)])
def test_alone_without_an_interface_is_an_outage(counters):
    """No peer and no carrier: there is no link."""
    assert Link().ticks(5, silent=True, counters=counters).state is LinkState.OUTAGE


def test_a_peer_that_leaves_takes_its_queue_along():
    """When nobody measures the queue any more, its last length does not go on as an estimate."""
    link = Link().measured()
    assert link.ticks(8, delay_s=0.5, rate=5e5).queue_delay_s > 0.4
    estimate = link.ticks(30, silent=True, peers=0)
    assert estimate.queue_delay_s == 0.0
    assert estimate.kind is CapacityKind.LOCAL
    assert estimate.state is not LinkState.OUTAGE


def test_pinning_the_capacity_forgets_the_queue():
    """An operator who pins the capacity on a congested link is not left with the queue of that moment."""
    link = Link().measured()
    assert link.ticks(8, delay_s=0.5, rate=5e5).queue_delay_s > 0.4
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
    """Delays of two hosts have two clock offsets: each is compared with its own."""
    link = Link().measured()
    for _ in range(20):
        link.tick()
        estimate = link.tick(peer="q", clock_s=5.0)
    assert estimate.queue_delay_s < 0.01
    assert estimate.capacity_bytes_per_second == FIRST


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
    assert 4.2e5 < estimate.cross_traffic_bytes_per_second < 5e5
    assert estimate.available_bytes_per_second == FIRST - estimate.cross_traffic_bytes_per_second


def test_a_pinned_capacity_is_shared_with_foreign_traffic():
    """What is pinned is what the link carries, not what of it is left."""
    link = Link(capacity_bytes_per_second=3e6)
    for step in range(60):
        estimate = link.tick(counters=replace(UP, tx_bytes=round(step * 0.1 * 5e5)))
    assert estimate.available_bytes_per_second == 3e6 - estimate.cross_traffic_bytes_per_second < 3e6 - 4.2e5


@given(st.floats(0.0, 1e9), st.floats(0.0, 1e9))
def test_at_most_half_is_yielded(capacity, foreign):
    """However much others carry, half of the capacity stays available."""
    estimate = replace(Link().tick(), capacity_bytes_per_second=capacity, cross_traffic_bytes_per_second=foreign)
    assert MOST_YIELDED * capacity <= estimate.available_bytes_per_second <= capacity


def test_its_own_probes_are_not_foreign():
    """The trains of the first seconds, which are many and large, are known to be ours."""
    link = Link()
    for _ in range(60):
        sent = sum(probe.packets * probe_wire_bytes(probe.packet_bytes) for _, probe in link.probes)
        estimate = link.tick(counters=replace(UP, tx_bytes=sent), peers=1)
        assert estimate.cross_traffic_bytes_per_second == 0.0
    assert sent > 6 * 40_000


# -- counters that do what counters do


@pytest.mark.parametrize(
    "course",
    [
        lambda step: replace(UP, tx_bytes=step * 10**6 % 10**7),
        lambda step: replace(UP, tx_bytes=step * 10_000, tx_dropped=step) if step % 3 else None,
        lambda step: replace(UP, tx_bytes=5 * 10**9),
        lambda step: replace(UP, tx_bytes=step * 10_000, state=list(InterfaceState)[step % 3]),
        lambda _: None,
    ],
    ids=["reset", "vanish", "stand still", "go down", "are gone"],
)
def test_counters_that_fail_are_no_evidence(course):
    """With a peer that reports, whatever becomes of this host's counters leaves capacity, kind and state alone."""
    link = Link().measured()
    for step in range(60):
        estimate = link.tick(counters=course(step), rate=1e5)
        assert estimate.capacity_bytes_per_second == FIRST
        assert estimate.kind is CapacityKind.PEER
        assert estimate.state is LinkState.APP_LIMITED


def test_a_peer_whose_counters_stand_still_is_no_queue():
    """An interface of the peer's that cannot be read delivers nothing, and says nothing of the link."""
    link = Link().measured()
    estimate = link.ticks(50, rate=0.0, counters=replace(UP, tx_bytes=10**6))
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.delivery_rate_bytes_per_second == 0.0


# -- the radio


RADIO = 1e6  # bytes/s


def test_alone_the_radio_bounds_the_belief():
    """No link carries more than its radio sends: without a peer, that much of it is believed, and it is said."""
    estimate = Link().ticks(5, silent=True, radio=RADIO)
    assert estimate.capacity_bytes_per_second == TUNING.radio_share * RADIO
    assert estimate.kind is CapacityKind.RADIO
    assert "radio" in estimate.evidence


@pytest.mark.parametrize("radio", [None, FIRST / TUNING.radio_share, 1e9])
def test_a_radio_that_is_fast_enough_or_absent_bounds_nothing(radio):
    """An absent radio is an absent bound, and a fast one is no evidence that the link is as fast."""
    estimate = Link().ticks(5, silent=True, radio=radio)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.kind is CapacityKind.CONFIGURED


def test_a_radio_bounds_what_was_learnt_alone():
    """A local measurement from before the radio slowed down is bounded, and is itself again afterwards."""
    link = Link()
    for step in range(30):
        estimate = link.tick(silent=True, counters=replace(UP, tx_bytes=step * 200_000, tx_dropped=step))
    assert estimate.kind is CapacityKind.LOCAL
    slowed = link.tick(silent=True, radio=RADIO, counters=replace(UP, tx_bytes=6_200_000, tx_dropped=30))
    assert (slowed.kind, slowed.capacity_bytes_per_second) == (CapacityKind.RADIO, TUNING.radio_share * RADIO)
    again = link.tick(silent=True, counters=replace(UP, tx_bytes=6_400_000, tx_dropped=30))
    assert again.kind is CapacityKind.LOCAL
    assert again.capacity_bytes_per_second > TUNING.radio_share * RADIO


def test_what_a_peer_measured_needs_no_radio():
    """A driver's bit rate is a guess, and arrivals at the peer are not."""
    estimate = Link().measured().tick(radio=RADIO)
    assert (estimate.kind, estimate.capacity_bytes_per_second) == (CapacityKind.PEER, FIRST)


def test_a_pin_overrides_the_radio():
    """What an operator pins is believed as it is."""
    estimate = Link(capacity_bytes_per_second=3e6).ticks(5, silent=True, radio=RADIO)
    assert (estimate.kind, estimate.capacity_bytes_per_second) == (CapacityKind.CONFIGURED, 3e6)


# -- kind, evidence, age


def test_the_evidence_tells_the_last_change():
    """Every change of the capacity is told in words, with the capacity, and its age counts from there."""
    link = Link()
    assert link.tick().evidence == "no evidence yet"
    link.measured()
    first = link.tick()
    assert "first 3 trains" in first.evidence
    assert f"{FIRST * 8e-6:.2f} Mbit/s" in first.evidence
    assert first.age_s == pytest.approx(0.1)
    assert link.ticks(20).age_s == pytest.approx(2.1)
    queue = link.ticks(5, rate=5e5, delay_s=0.3)
    assert "queue of" in queue.evidence
    assert f"{queue.capacity_bytes_per_second * 8e-6:.2f} Mbit/s" in queue.evidence
    assert queue.age_s < 0.31


def test_a_train_that_confirms_makes_the_belief_young():
    """What is still seen is no old belief, though nothing changes."""
    link = Link().measured()
    assert link.ticks(50).age_s > 4.9
    estimate = link.tick(trains=[FIRST])
    assert estimate.age_s == 0.0
    assert "first 3 trains" in estimate.evidence


def test_a_pin_does_not_age():
    """It is true until the configuration changes."""
    assert Link(capacity_bytes_per_second=3e6).ticks(50).age_s == 0.0


def test_a_belief_that_nothing_confirms_grows_old():
    """From the start on, for the configured one; from the last report's evidence on, in an outage."""
    assert Link().ticks(51, silent=True).age_s == pytest.approx(5.0, abs=0.2)
    assert Link().measured().ticks(50, silent=True).age_s == pytest.approx(5.0)


@pytest.mark.parametrize(("rate", "state"), [(0.5 * FIRST, LinkState.APP_LIMITED), (0.84 * FIRST, LinkState.STEADY)])
def test_a_link_in_use_is_steady_and_an_idle_one_app_limited(rate, state):
    """Whether the traffic itself would show a change of the capacity is told."""
    assert Link().measured().ticks(5, rate=rate).state is state


# -- nothing at all may break it


COUNTERS = st.one_of(
    st.none(),
    st.builds(
        lambda tx, rx, dropped, backlog, state: replace(
            UP, tx_bytes=tx, rx_bytes=rx, tx_dropped=dropped, backlog_bytes=backlog, state=state
        ),
        st.integers(0, 10**10),
        st.integers(0, 10**10),
        st.integers(0, 10**6),
        st.one_of(st.none(), st.integers(0, 10**8)),
        st.sampled_from(InterfaceState),
    ),
)
ODD_TRAINS = st.builds(
    Train,
    payload_bytes=st.integers(0, 10**6),
    duration_s=st.one_of(st.just(0.0), st.floats(1e-40, 10.0)),
    packets=st.integers(0, 100),
    sent_s=st.floats(0.0, 10.0),
)
ODD_TICKS = st.lists(
    st.fixed_dictionaries(
        {
            "rate": st.floats(0.0, 1e9),
            "delay_s": st.floats(-1e3, 1e3),
            "trains": st.lists(ODD_TRAINS, max_size=3),
            "silent": st.booleans(),
            "counters": COUNTERS,
            "peer": st.sampled_from("pqr"),
            "peers": st.sampled_from([None, 0, 1, 3]),
            "clock_s": st.sampled_from([0.0, -1e9, 1e9]),
            "radio": st.one_of(st.none(), st.floats(0.0, 1e9)),
            "interval_s": st.floats(0.0, 20.0),
        }
    ),
    max_size=40,
)


@settings(deadline=None, max_examples=60)
@given(ODD_TICKS)
def test_nothing_whatever_makes_it_say_nonsense(ticks):
    """Any observations in any order: every number of the estimate is finite and not negative, and probes are few."""
    link = Link()
    for tick in ticks:
        estimate = link.tick(**tick)
        numbers = {
            name: value
            for name in estimate.__dataclass_fields__
            if isinstance(value := getattr(estimate, name), float | int)
        }
        assert all(0.0 <= value < math.inf for value in numbers.values()), numbers
        assert 0.0 <= estimate.available_bytes_per_second <= estimate.capacity_bytes_per_second
        assert estimate.evidence
    assert len(link.probes) <= 2 * len(ticks)


def test_a_peer_that_leaves_after_a_long_time_is_no_fall():
    """What was sent while the peer measured is not what the link can carry, though a packet was dropped meanwhile."""
    link = Link()
    sent = 0

    def counters(dropped=0):
        nonlocal sent
        sent += 1_000
        return replace(UP, tx_bytes=sent, tx_dropped=dropped)

    for _ in range(15):
        link.tick(silent=True, counters=counters(), peers=0)
    link.ticks(12)
    for _ in range(3):
        link.tick(trains=[FIRST], counters=counters())
    for _ in range(100):
        link.tick(counters=counters(1))
    for _ in range(30):
        estimate = link.tick(silent=True, counters=counters(1), peers=0)
        assert estimate.capacity_bytes_per_second >= FIRST


# -- what it says beside the capacity


def test_every_rule_that_speaks_is_counted():
    """First trains, a fall, what contradicts it, an outage and its end; a rule that changes nothing is silent."""
    link = Link().measured()
    assert link.ticks(3).events_by_kind == {"first": 1}
    fallen = link.ticks(8, rate=0.4 * FIRST, delay_s=0.4)
    assert fallen.events_by_kind["down"] >= 1
    assert link.ticks(12, silent=True).events_by_kind["outage"] == 1
    resumed = link.ticks(5, delay_s=0.02)
    assert (resumed.events_by_kind["outage"], resumed.events_by_kind["resume"]) == (1, 1)
    assert set(resumed.events_by_kind) <= {*map(str, EstimatorEvent)}


def test_events_of_an_estimate_never_change():
    """An estimate is a value: what comes later is not in it."""
    link = Link()
    before = link.tick()
    link.measured()
    assert (dict(before.events_by_kind), link.tick().events_by_kind["first"]) == ({}, 1)


def test_who_is_alone_has_no_peer_to_tell_of_loss_and_of_the_way_back():
    """Without a report both are unknown; and in an outage nobody knows what becomes of what is under way."""
    link = Link()
    alone = link.ticks(30, silent=True)
    assert (alone.loss_ratio, alone.return_delay_s) == (None, None)
    heard = link.ticks(40, return_delay_s=7.0)
    assert (heard.loss_ratio, heard.return_delay_s) == (0.0, 0.0)
    out = link.ticks(6, silent=True)
    assert out.state is LinkState.OUTAGE
    assert (out.loss_ratio, out.return_delay_s) == (None, None)
