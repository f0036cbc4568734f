"""Rules of the estimator, one by one, and the bounds that no evidence may break."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.estimate.estimator import Estimator
from arpd.estimate.parameters import EstimatorParameters
from arpd.model.interface import InterfaceState
from arpd.model.link import MOST_YIELDED, CapacityKind, EstimatorEvent, LinkState
from arpd.model.probing import PeerReport, Train
from arpd.model.settings import LinkSettings
from arpd.model.wire import probe_wire_bytes
from tests.sample_link import INTERFACE, LINK, observation

PARAMETERS = EstimatorParameters()
FIRST = 2.0e6
SIZE, PACKETS = 14_900, 10  # bytes of a train and the packets they are in


def seen(capacity):
    """Return a train that saw this capacity."""
    return Train(payload_bytes=SIZE, duration_s=SIZE / capacity, packets=PACKETS)


class Link:
    """Feeds an estimator: probes leave every 100 ms, and 10 ms later a report arrives unless the peer is silent."""

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
        counters=INTERFACE,
        peer="p",
        peers=None,
        clock_s=0.0,
        radio=None,
        publishers=(),
        interval_s=0.1,
        return_delay_s=None,
    ):
        seen_s = self.now_s + 0.09
        fields = {"counters": counters, "publishers": publishers, "peers": peers, "radio_bytes_per_second": radio}
        self.estimator.update(observation(seen_s, **fields))
        self.probes += [(seen_s, each) for each in self.estimator.wanted_probes(seen_s)]
        self.now_s += 0.1
        # Probes that wait in a queue have not arrived yet; those lost in an outage never will.
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
        return self.estimator.update(observation(self.now_s, reports=() if silent else (report,), **fields))

    def ticks(self, count, **kwargs):
        for _ in range(count):
            estimate = self.tick(**kwargs)
        return estimate

    def measured(self, capacity=FIRST):
        """Measure a capacity."""
        self.ticks(12)
        for _ in range(3):
            estimate = self.tick(trains=[capacity])
        assert estimate.kind is CapacityKind.PEER
        return self


def test_before_evidence_the_configured_capacity_counts():
    """The first estimate is the configured capacity, also after a reload, and says so."""
    link = Link()
    assert link.tick().capacity_bytes_per_second == FIRST
    link.estimator.reconfigure(LinkSettings(initial_capacity_bytes_per_second=1e5))
    estimate = link.tick()
    assert (estimate.capacity_bytes_per_second, estimate.kind) == (1e5, CapacityKind.CONFIGURED)
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


@pytest.mark.parametrize(("peers", "wait_s"), [(None, PARAMETERS.first_wait_s), (1, PARAMETERS.peer_lost_s)])
def test_without_reports_the_first_plan_waits(peers, wait_s):
    """Without anyone to measure, planning begins after three seconds; a peer in the graph makes it wait longer."""
    link = Link()
    link.ticks(round(10 * wait_s) - 2, silent=True, peers=peers)
    assert not link.estimator.has_evidence
    link.ticks(3, silent=True, peers=peers)
    assert link.estimator.has_evidence


def test_a_standing_queue_makes_delivery_the_capacity():
    """After two reports of a high delay, the delivery is the capacity."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    # For 300 ms no ping arrives, and then one does.
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
    """While the link delivers the believed capacity, a queue only means that too much was sent."""
    link = Link().measured()
    link.ticks(4, rate=0.97 * FIRST)
    estimate = link.ticks(10, rate=0.97 * FIRST, delay_s=0.3)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.state is LinkState.CONGESTED


def fallen():
    """Return a link that fell from `FIRST` to a quarter of it just now, and whose queue is gone."""
    link = Link().measured()
    link.ticks(4, rate=5e5)
    link.ticks(6, rate=5e5, delay_s=0.3)
    link.ticks(2, rate=5e5)
    return link


def test_trains_undo_a_fall_they_contradict():
    """Two trains end a fall that a short disturbance caused."""
    link = fallen()
    assert link.tick(trains=[0.97 * FIRST]).capacity_bytes_per_second < 0.3 * FIRST
    estimate = link.tick(trains=[0.95 * FIRST])
    assert estimate.capacity_bytes_per_second == pytest.approx(0.95 * FIRST)
    assert "contradict" in estimate.evidence


def test_a_fall_is_undone_once():
    """After an undo, trains no longer refer to that fall."""
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
    """A link that became much better is used within two trains, at a little less than they see."""
    link = Link().measured()
    assert link.tick(trains=[4 * FIRST]).capacity_bytes_per_second == FIRST
    estimate = link.tick(trains=[5 * FIRST])
    assert estimate.capacity_bytes_per_second == pytest.approx(PARAMETERS.caution * 4 * FIRST)
    assert "two trains" in estimate.evidence


def test_two_trains_far_apart_do_not_agree():
    """An old train confirms nothing."""
    link = Link().measured()
    link.tick(trains=[4 * FIRST])
    link.ticks(round(PARAMETERS.agree_window_s / 0.1) + 1)
    assert link.tick(trains=[4 * FIRST]).capacity_bytes_per_second < 1.2 * FIRST


def test_one_low_train_is_no_fall():
    """Another message inside a train makes it read low, so one low train changes nothing."""
    link = Link().measured()
    for train in [FIRST, 0.3 * FIRST, FIRST, FIRST, 0.5 * FIRST, FIRST]:
        estimate = link.tick(trains=[train])
    assert estimate.capacity_bytes_per_second == FIRST


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(1e4, 1e8), min_size=10, max_size=60))
def test_trains_move_it_no_faster_than_they_may(trains):
    """Without a queue it moves by a bounded part per second, or rises to what two trains agree on."""
    link = Link().measured()
    step = 0.1 * PARAMETERS.climb_per_second * 1.001
    before, last = FIRST, FIRST
    for train in trains:
        after = link.tick(trains=[train]).capacity_bytes_per_second
        assert before * (1 - step) <= after <= max(before * (1 + step), min(train, last))
        before, last = after, train


def test_silence_is_an_outage_and_no_capacity():
    """After 400 ms without a report the link is out; the capacity stays."""
    link = Link().measured()
    assert link.ticks(3, silent=True).state is not LinkState.OUTAGE
    estimate = link.ticks(2, silent=True)
    assert estimate.state is LinkState.OUTAGE
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.delivery_rate_bytes_per_second == 0.0


@pytest.mark.parametrize(("ticks", "part"), [(30, PARAMETERS.resume_ratio), (6, 1.0)])
def test_after_an_outage_it_resumes_below_what_it_knew(ticks, part):
    """An outage leaves a part of the old capacity, because the link may be another one; a short silence leaves all."""
    link = Link().measured()
    link.ticks(ticks, silent=True)
    assert link.tick().capacity_bytes_per_second == pytest.approx(part * FIRST)


@pytest.mark.parametrize("trouble", [{"silent": True}, {"rate": 5e5, "delay_s": 0.3}], ids=["outage", "queue"])
def test_an_outage_or_a_queue_stops_the_trains(trouble):
    """A train would measure nothing, and would lengthen a queue; pings are rare in an outage."""
    link = Link().measured()
    link.ticks(10, **trouble)
    link.probes.clear()
    link.ticks(40, **trouble)
    assert all(probe.packets == 1 for _, probe in link.probes)
    assert "silent" not in trouble or 7 <= len(link.probes) <= 9


def test_a_pinned_capacity_is_believed_and_nothing_is_probed():
    """Neither trains nor a radio change a pinned capacity; it does not age, and no probe is sent."""
    link = Link(capacity_bytes_per_second=3e6)
    for estimate in (link.ticks(20, trains=[1e6]), link.ticks(5, silent=True, radio=RADIO)):
        assert (estimate.capacity_bytes_per_second, estimate.kind) == (3e6, CapacityKind.CONFIGURED)
        assert estimate.age_s == 0.0
    assert link.estimator.has_evidence
    assert not link.probes


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
def test_at_any_evidence_the_estimate_is_a_capacity(ticks):
    """It is positive, of a finite age, and never above everything that was configured or seen."""
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
    """One-way delays count only above their minimum, so a clock offset changes nothing."""
    here, there = Link(), Link()
    for tick in ticks:
        one = here.tick(**tick)
        other = there.tick(**tick, clock_s=offset_s)
        assert other.capacity_bytes_per_second == pytest.approx(one.capacity_bytes_per_second)
        assert other.state == one.state


def test_alone_a_local_queue_shows_the_capacity():
    """Without a peer, what leaves while the interface drops packets is the capacity, and its kind is local."""
    link = Link()
    sent = 0
    for step in range(130):
        sent += 30_000
        counters = replace(INTERFACE, tx_bytes=sent, tx_dropped=step)
        estimate = link.tick(silent=True, counters=counters)
    assert estimate.kind is CapacityKind.LOCAL
    assert estimate.capacity_bytes_per_second == pytest.approx(300_000, rel=0.02)
    assert "local queue" in estimate.evidence


@pytest.mark.parametrize("counters", [None, replace(INTERFACE, state=InterfaceState.DOWN)])
def test_alone_without_an_interface_is_an_outage(counters):
    """No peer and no carrier: there is no link."""
    assert Link().ticks(5, silent=True, counters=counters).state is LinkState.OUTAGE


def test_a_peer_that_leaves_takes_its_queue_along():
    """When no peer measures the queue, its last length is forgotten."""
    link = Link().measured()
    assert link.ticks(8, delay_s=0.5, rate=5e5).queue_delay_s > 0.4
    estimate = link.ticks(30, silent=True, peers=0)
    assert estimate.queue_delay_s == 0.0
    assert estimate.kind is CapacityKind.LOCAL
    assert estimate.state is not LinkState.OUTAGE


def test_pinning_the_capacity_forgets_the_queue():
    """After pinning the capacity on a congested link, the last queue is forgotten."""
    link = Link().measured()
    assert link.ticks(8, delay_s=0.5, rate=5e5).queue_delay_s > 0.4
    link.estimator.reconfigure(LinkSettings(capacity_bytes_per_second=1e6))
    assert link.tick(silent=True).queue_delay_s == 0.0


@pytest.mark.parametrize("link", [Link().measured(), Link(capacity_bytes_per_second=FIRST)], ids=["measured", "pinned"])
def test_cross_traffic_reduces_only_what_is_available(link):
    """A measured or pinned capacity is that of the whole link; cross traffic is subtracted from it."""
    for step in range(60):
        estimate = link.tick(counters=replace(INTERFACE, tx_bytes=round(step * 0.1 * 5e5)))
    assert estimate.capacity_bytes_per_second == FIRST
    assert 4.2e5 < estimate.cross_traffic_bytes_per_second < 5e5
    assert estimate.available_bytes_per_second == FIRST - estimate.cross_traffic_bytes_per_second


@given(st.floats(0.0, 1e9), st.floats(0.0, 1e9))
def test_at_most_half_is_yielded(capacity, cross_traffic):
    """At any cross traffic half of the capacity stays available."""
    estimate = replace(LINK, capacity_bytes_per_second=capacity, cross_traffic_bytes_per_second=cross_traffic)
    assert MOST_YIELDED * capacity <= estimate.available_bytes_per_second <= capacity


def test_its_own_probes_are_no_cross_traffic():
    """The many large trains of the first seconds count as our own."""
    link = Link()
    for _ in range(60):
        sent = sum(probe.packets * probe_wire_bytes(probe.packet_bytes) for _, probe in link.probes)
        estimate = link.tick(counters=replace(INTERFACE, tx_bytes=sent), peers=1)
        assert estimate.cross_traffic_bytes_per_second == 0.0
    assert sent > 6 * 40_000


# -- counters that misbehave


@pytest.mark.parametrize(
    "course",
    [
        lambda step: replace(INTERFACE, tx_bytes=step * 10**6 % 10**7),
        lambda step: replace(INTERFACE, tx_bytes=step * 10_000, tx_dropped=step) if step % 3 else None,
        lambda step: replace(INTERFACE, tx_bytes=5 * 10**9),
        lambda step: replace(INTERFACE, tx_bytes=step * 10_000, state=list(InterfaceState)[step % 3]),
        lambda _: None,
    ],
    ids=["reset", "vanish", "stand still", "go down", "are gone"],
)
def test_counters_that_fail_are_no_evidence(course):
    """While a peer reports, counters of this host that fail change neither capacity nor kind nor state."""
    link = Link().measured()
    for step in range(60):
        estimate = link.tick(counters=course(step), rate=1e5)
        assert estimate.capacity_bytes_per_second == FIRST
        assert estimate.kind is CapacityKind.PEER
        assert estimate.state is LinkState.APP_LIMITED


def test_a_peer_whose_counters_stand_still_is_no_queue():
    """A peer that cannot read its interface reports no bytes, which says nothing about the link."""
    link = Link().measured()
    estimate = link.ticks(50, rate=0.0, counters=replace(INTERFACE, tx_bytes=10**6))
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.delivery_rate_bytes_per_second == 0.0


# -- the radio


RADIO = 1e6  # bytes/s


def test_alone_the_radio_bounds_the_belief():
    """Without a peer the capacity is at most a share of the radio's bit rate, and the evidence says so."""
    estimate = Link().ticks(5, silent=True, radio=RADIO)
    assert estimate.capacity_bytes_per_second == PARAMETERS.radio_share * RADIO
    assert estimate.kind is CapacityKind.RADIO
    assert "radio" in estimate.evidence


@pytest.mark.parametrize("radio", [None, FIRST / PARAMETERS.radio_share, 1e9])
def test_a_radio_that_is_fast_enough_or_absent_bounds_nothing(radio):
    """Without a radio there is no bound, and a fast radio raises nothing."""
    estimate = Link().ticks(5, silent=True, radio=radio)
    assert estimate.capacity_bytes_per_second == FIRST
    assert estimate.kind is CapacityKind.CONFIGURED


def test_a_radio_bounds_a_local_measurement():
    """A slower radio bounds an earlier local measurement, which returns when the radio is gone."""
    link = Link()
    for step in range(30):
        estimate = link.tick(silent=True, counters=replace(INTERFACE, tx_bytes=step * 200_000, tx_dropped=step))
    assert estimate.kind is CapacityKind.LOCAL
    slowed = link.tick(silent=True, radio=RADIO, counters=replace(INTERFACE, tx_bytes=6_200_000, tx_dropped=30))
    assert (slowed.kind, slowed.capacity_bytes_per_second) == (CapacityKind.RADIO, PARAMETERS.radio_share * RADIO)
    again = link.tick(silent=True, counters=replace(INTERFACE, tx_bytes=6_400_000, tx_dropped=30))
    assert again.kind is CapacityKind.LOCAL
    assert again.capacity_bytes_per_second > PARAMETERS.radio_share * RADIO


def test_what_a_peer_measured_needs_no_radio():
    """A measurement of a peer overrides the bit rate of the radio."""
    estimate = Link().measured().tick(radio=RADIO)
    assert (estimate.kind, estimate.capacity_bytes_per_second) == (CapacityKind.PEER, FIRST)


# -- kind, evidence, age


def test_the_evidence_tells_the_last_change():
    """The evidence names the last change and the capacity, and the age counts from there."""
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


def test_a_train_that_confirms_makes_the_estimate_young():
    """A train resets the age even if it changes nothing."""
    link = Link().measured()
    assert link.ticks(50).age_s > 4.9
    estimate = link.tick(trains=[FIRST])
    assert estimate.age_s == 0.0
    assert "first 3 trains" in estimate.evidence


def test_an_estimate_that_nothing_confirms_grows_old():
    """A configured capacity ages from the start, a measured one from its last evidence, also in an outage."""
    assert Link().ticks(51, silent=True).age_s == pytest.approx(5.0, abs=0.2)
    assert Link().measured().ticks(50, silent=True).age_s == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("rate", "state"),
    [(1e3, LinkState.APP_LIMITED), (0.5 * FIRST, LinkState.APP_LIMITED), (0.84 * FIRST, LinkState.STEADY)],
)
def test_a_link_in_use_is_steady_and_an_idle_one_app_limited(rate, state):
    """Throughput alone is no capacity; the state tells whether traffic would show a change."""
    estimate = Link().measured().ticks(50, rate=rate)
    assert (estimate.capacity_bytes_per_second, estimate.state) == (FIRST, state)
    assert estimate.is_app_limited == (state is LinkState.APP_LIMITED)


# -- odd evidence


COUNTERS = st.one_of(
    st.none(),
    st.builds(
        lambda tx, rx, dropped, backlog, state: replace(
            INTERFACE, tx_bytes=tx, rx_bytes=rx, tx_dropped=dropped, backlog_bytes=backlog, state=state
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
def test_odd_evidence_makes_no_nonsense(ticks):
    """At any observations, all numbers of the estimate are finite and not negative, and probes are few."""
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
    """Bytes sent while the peer measured are no local measurement, although a packet was dropped meanwhile."""
    link = Link()
    sent = 0

    def counters(dropped=0):
        nonlocal sent
        sent += 1_000
        return replace(INTERFACE, tx_bytes=sent, tx_dropped=dropped)

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


# -- further fields


def test_every_change_is_counted_by_its_rule():
    """First trains, a fall, an outage and its end count; a rule that changes nothing does not."""
    link = Link().measured()
    assert link.ticks(3).events_by_kind == {"first": 1}
    fallen = link.ticks(8, rate=0.4 * FIRST, delay_s=0.4)
    assert fallen.events_by_kind["down"] >= 1
    assert link.ticks(12, silent=True).events_by_kind["outage"] == 1
    resumed = link.ticks(5, delay_s=0.02)
    assert (resumed.events_by_kind["outage"], resumed.events_by_kind["resume"]) == (1, 1)
    assert set(resumed.events_by_kind) <= {*map(str, EstimatorEvent)}


def test_events_of_an_estimate_never_change():
    """Later events do not change an earlier estimate."""
    link = Link()
    before = link.tick()
    link.measured()
    assert (dict(before.events_by_kind), link.tick().events_by_kind["first"]) == ({}, 1)


def test_loss_and_way_back_are_unknown_without_reports():
    """Both are unknown without a peer and in an outage."""
    link = Link()
    alone = link.ticks(30, silent=True)
    assert (alone.loss_ratio, alone.return_delay_s) == (None, None)
    heard = link.ticks(40, return_delay_s=7.0)
    assert (heard.loss_ratio, heard.return_delay_s) == (0.0, 0.0)
    out = link.ticks(6, silent=True)
    assert out.state is LinkState.OUTAGE
    assert (out.loss_ratio, out.return_delay_s) == (None, None)
