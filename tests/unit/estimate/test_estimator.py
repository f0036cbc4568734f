"""Estimator, observation by observation: what it believes of whom, and the bounds that no evidence may break."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate import parameters
from arpd.estimate.estimator import Estimator
from arpd.model.endpoints import Direction
from arpd.model.interface import InterfaceState
from arpd.model.link import CapacityKind, LinkState
from arpd.model.probing import PeerReport, Train
from arpd.model.settings import LinkSettings
from tests.examples import examples
from tests.sample_link import INTERFACE, observation
from tests.sample_publishers import publisher

FIRST = 2.0e6
FALLEN = {"rate": 5e5, "delay_s": 0.3}  # a quarter of it, behind a queue
SIZE, PACKETS = 14_900, 10  # bytes of a train and the packets they are in


def about(capacity, part=0.1):
    return pytest.approx(capacity, rel=part)


class Link:
    """Feeds an estimator: probes leave every 100 ms, and 10 ms later a report arrives unless the peer is silent."""

    def __init__(self, **link):
        self.estimator = Estimator(LinkSettings(initial_capacity_bytes_per_second=FIRST, **link))
        self.now_s = 500.0
        self.sent = 0.0  # bytes
        self.probes = []  # when they left, and what they were
        self.arrived = 0  # the last of them

    def tick(
        self,
        *,
        rate=1e5,  # at which the peer receives
        sent=None,  # at which this host sends, if it is another one
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
    ):
        seen_s = self.now_s + 0.09
        fields = {"counters": counters, "publishers": publishers, "peers": peers, "radio_bytes_per_second": radio}
        if counters is INTERFACE:
            self.sent += 0.1 * (rate if sent is None else sent)
            fields["counters"] = replace(INTERFACE, tx_bytes=round(self.sent))
        self.estimator.update(observation(seen_s, **fields))
        self.probes += [(seen_s, each) for each in self.estimator.wanted_probes(seen_s, is_short=False)]
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
            trains=tuple(
                each if isinstance(each, Train) else Train(payload_bytes=SIZE, duration_s=SIZE / each, packets=PACKETS)
                for each in trains
            ),
            last_probe=self.arrived,
            probe_packets=sum(each.packets for _, each in self.probes if each.number < self.arrived),
        )
        return self.estimator.update(observation(self.now_s, reports=() if silent else (report,), **fields))

    def ticks(self, count, **kwargs):
        for _ in range(count):
            estimate = self.tick(**kwargs)
        return estimate

    def measured(self):
        """Measure the capacity `FIRST`."""
        self.ticks(12)
        estimate = self.ticks(3, trains=[FIRST])
        assert estimate.kind is CapacityKind.PEER
        assert estimate.capacity_bytes_per_second == about(FIRST)
        return self


# -- before a peer has measured


@pytest.mark.parametrize(("peers", "wait_s"), [(None, parameters.FIRST_WAIT_S), (1, parameters.PEER_LOST_S)])
def test_without_reports_the_first_plan_waits(peers, wait_s):
    """Without anyone to measure, planning begins after three seconds; a peer in the graph makes it wait longer."""
    link = Link()
    link.ticks(round(10 * wait_s) - 2, silent=True, peers=peers)
    assert not link.estimator.has_evidence
    link.ticks(3, silent=True, peers=peers)
    assert link.estimator.has_evidence


def test_a_peer_that_is_discovered_late_takes_back_no_evidence():
    """Discovery takes seconds: the topics stay planned, and slowed, while the peer has not measured yet."""
    link = Link()
    link.ticks(round(10 * parameters.FIRST_WAIT_S) + 1, silent=True, peers=0)
    link.tick(silent=True, peers=1)
    assert link.estimator.has_evidence


# -- queues and trains


@pytest.mark.parametrize("counters", [INTERFACE, None], ids=["counted", "pings alone"])
def test_what_arrives_while_a_queue_stands_is_the_capacity(counters):
    """A queue that several pings meet makes the delivery the capacity within 1.5 s, also where nothing is counted."""
    link = Link().measured()
    estimate = link.ticks(15, counters=counters, **FALLEN)
    assert estimate.capacity_bytes_per_second == about(5e5)
    assert estimate.state is LinkState.DRAINING
    assert estimate.queue_delay_s == pytest.approx(0.28, abs=0.1)
    assert estimate.standing_delay_s > 0.1
    assert link.ticks(5, trains=[FIRST]).capacity_bytes_per_second > 6e5


def test_the_evidence_is_what_was_seen():
    """It names what the trains saw and what was carried, each with its own rate; what an idle link carries is none."""
    assert Link().measured().tick().evidence == "trains see 16 Mbit/s"
    link = Link().measured()
    link.ticks(3, rate=1.2e6)
    estimate = link.tick(rate=1.2e6, trains=[1.5 * FIRST])
    assert estimate.evidence == "trains see 24 Mbit/s; 9.6 Mbit/s carried without a queue"


def test_a_queue_at_the_start_shows_the_capacity():
    """A daemon that starts again beside a queue does not wait for trains, of which none would leave."""
    link = Link()
    link.ticks(12)
    estimate = link.ticks(15, **FALLEN)
    assert link.estimator.has_evidence
    assert estimate.kind is CapacityKind.PEER
    assert estimate.capacity_bytes_per_second == about(5e5)


def test_samples_that_stay_on_the_host_are_no_bursts():
    """Large samples for remote readers may stand before the link for a moment; local ones never do."""
    allowances = {
        direction: Link()
        .measured()
        .tick(publishers=(publisher("/n", "/map", payload_bytes=2e6, direction=direction),))
        .queue_allowance_s
        for direction in Direction
    }
    without = Link().measured().tick().queue_allowance_s
    assert allowances[Direction.LOCAL] == without
    assert without < allowances[Direction.SENSING] <= without + parameters.BURST_CAP_S


# -- silence


def test_silence_is_an_outage_and_no_capacity():
    """After 400 ms without a report the link is out; what is known of it stays and grows old, whatever leaves."""
    link = Link().measured()
    before = link.tick()
    assert link.ticks(3, silent=True).state is not LinkState.OUTAGE
    for estimate in (link.ticks(2, silent=True), sent_alone(link, 50, rate=1e3, backlog=200_000)):
        assert estimate.state is LinkState.OUTAGE
        assert estimate.capacity_bytes_per_second == about(before.capacity_bytes_per_second, 0.02)
        assert estimate.delivery_rate_bytes_per_second == 0.0
    assert estimate.age_s > 5.0


@pytest.mark.parametrize("rises", [False, True])
def test_where_reports_are_rare_one_lost_report_is_no_outage(rises):
    """On a link that is slow, or was until the last probe that arrived, 1.3 s of silence is none, and 1.6 s is one."""
    link = Link().measured()
    link.ticks(3, trains=[1e4], rate=1e3)
    link.ticks(20, rate=1e3)
    is_fast = link.tick(trains=[FIRST] * 3 * rises, rate=1e3).capacity_bytes_per_second > 0.5 * FIRST
    assert is_fast is rises
    assert link.ticks(13, silent=True).state is not LinkState.OUTAGE
    assert link.ticks(3, silent=True).state is LinkState.OUTAGE


def test_a_train_that_leaps_is_asked_for_again_before_it_counts():
    """A receiver that slept stamps a train at its own pace: the next train comes soon, and only both together count."""
    fast = Train(payload_bytes=SIZE, duration_s=SIZE / (8 * FIRST), packets=PACKETS, sent_s=SIZE / (9 * FIRST))
    link = Link().measured()
    link.ticks(40, trains=[FIRST])
    link.ticks(25)
    assert link.tick(trains=[fast]).capacity_bytes_per_second == about(FIRST)
    link.probes.clear()
    asked_s = link.now_s
    assert link.ticks(6).capacity_bytes_per_second == about(FIRST)
    assert [at_s - asked_s < 0.3 for at_s, probe in link.probes if probe.packet_bytes == 1_200] == [True]
    assert link.tick(trains=[FIRST]).capacity_bytes_per_second == about(FIRST)
    assert link.tick(trains=[fast]).capacity_bytes_per_second == about(FIRST)
    assert link.tick(trains=[fast]).capacity_bytes_per_second > 6 * FIRST


@pytest.mark.parametrize("part", [0.2, 1.0, 3.0])
def test_after_an_outage_two_trains_show_the_link(part):
    """An outage may end on another link, so the estimate is less certain then, and a few trains decide."""
    link = Link().measured()
    link.ticks(30, silent=True)
    resumed = link.tick(rate=1e4)
    assert "resumed" in resumed.evidence
    link.ticks(4, rate=1e4)
    estimate = link.ticks(2, rate=1e4, trains=[part * FIRST])
    assert estimate.capacity_bytes_per_second == about(part * FIRST, 0.15)


def test_what_an_outage_held_up_is_a_queue_and_what_arrives_counts_at_once():
    """Pings that left before an outage ended, and arrive late, show how long they waited; a link may be slower now."""
    link = Link().measured()
    link.ticks(30, silent=True)
    estimate = link.ticks(3, delay_s=1.5, rate=5e5)
    assert 1.2 < estimate.queue_delay_s < 1.8
    assert estimate.state is LinkState.DRAINING
    assert estimate.capacity_bytes_per_second == about(5e5)


@pytest.mark.parametrize("trouble", [{"silent": True}, FALLEN], ids=["outage", "queue"])
def test_an_outage_or_a_queue_stops_the_trains(trouble):
    """A train would measure nothing, and would lengthen a queue; pings are rare in an outage."""
    link = Link().measured()
    link.ticks(10, **trouble)
    link.probes.clear()
    link.ticks(40, **trouble)
    assert all(probe.packets == 1 for _, probe in link.probes)
    assert "silent" not in trouble or 7 <= len(link.probes) <= 9


# -- pinned


def test_where_a_reload_pins_the_capacity_one_lost_report_is_no_outage():
    """No probe asks for a report any more, so a peer sends few."""
    link = Link().measured()
    link.estimator.reconfigure(LinkSettings(capacity_bytes_per_second=FIRST))
    for _report in range(20):
        link.ticks(2, silent=True)
        link.tick(interval_s=0.3)
    assert link.ticks(5, silent=True).state is not LinkState.OUTAGE


@pytest.mark.parametrize("how", ["pinned", "radio"])
def test_a_large_message_may_stand_as_long_as_the_capacity_in_force_takes(how):
    """What the configuration pins, or the radio allows, counts, and not the capacity that was assumed at first."""
    slow = 125_000.0
    link = Link(capacity_bytes_per_second=slow) if how == "pinned" else Link()
    large = publisher("/node", "/camera", payload_bytes=60_000, published_rate_hz=1.0)
    radio = None if how == "pinned" else slow / parameters.RADIO_SHARE
    for _ in range(20):
        estimate = link.tick(silent=True, peers=0, radio=radio, publishers=(large,))
    assert estimate.capacity_bytes_per_second == pytest.approx(slow)
    assert estimate.queue_allowance_s > 0.2


def test_a_queue_that_nobody_measures_now_is_forgotten():
    """When the peer leaves or the capacity is pinned, the last length of the queue must not hold the budget."""
    left, pinned = Link().measured(), Link().measured()
    for link in (left, pinned):
        assert link.ticks(8, delay_s=0.5, rate=5e5).queue_delay_s > 0.3
    estimate = left.ticks(30, silent=True, peers=0)
    assert estimate.queue_delay_s == 0.0
    assert estimate.state is not LinkState.OUTAGE
    pinned.estimator.reconfigure(LinkSettings(capacity_bytes_per_second=1e6))
    assert pinned.tick(silent=True).queue_delay_s == 0.0


# -- several peers


def test_what_peers_receive_adds_up_and_one_that_goes_changes_nothing():
    """Half of the bytes at each of two peers are no half of the link, and it is out only when both are silent."""
    link = Link().measured()
    for tick in range(60):
        both = link.tick(rate=0.4 * FIRST, sent=0.8 * FIRST, peer="ab"[tick % 2], delay_s=0.02, peers=2)
    assert both.delivery_rate_bytes_per_second == about(0.8 * FIRST)
    alone = link.ticks(30, rate=0.4 * FIRST, peer="a", peers=2)
    assert {both.state, alone.state} <= {LinkState.STEADY, LinkState.APP_LIMITED}
    assert alone.capacity_bytes_per_second > 0.8 * FIRST
    assert link.ticks(8, silent=True, peers=2).state is LinkState.OUTAGE


# -- no peer


def sent_alone(link, ticks, *, rate=300_000, backlog=0, peers=None):
    """Send for a while without a peer."""
    for _ in range(ticks):
        link.sent += 0.1 * rate
        counters = replace(INTERFACE, tx_bytes=round(link.sent), backlog_bytes=backlog)
        estimate = link.tick(silent=True, counters=counters, peers=peers)
    return estimate


def test_a_peer_that_returns_needs_new_trains():
    """What was measured before the peer left does not count when it is back; three new trains do."""
    link = Link().measured()
    sent_alone(link, 130, backlog=200_000, peers=0)
    estimate = link.ticks(10)
    assert estimate.kind is CapacityKind.LOCAL
    estimate = link.ticks(3, trains=[FIRST])
    assert estimate.kind is CapacityKind.PEER


def test_one_look_at_strange_bytes_is_an_outlier():
    """A strange rate over 50 ms is no capacity of a link without a peer; what leaves counts as delivered."""
    link = Link()
    assert sent_alone(link, 130, backlog=200_000, peers=0).delivery_rate_bytes_per_second == about(300_000)
    link.now_s += 0.05
    link.sent += 10 * 300_000 * 0.05
    counters = replace(INTERFACE, tx_bytes=round(link.sent), backlog_bytes=400_000)
    estimate = link.estimator.update(observation(link.now_s, counters=counters, peers=0))
    assert estimate.capacity_bytes_per_second < 1.3 * 300_000


@pytest.mark.parametrize("counters", [None, replace(INTERFACE, state=InterfaceState.DOWN)])
def test_alone_without_an_interface_is_an_outage(counters):
    """No peer and no carrier: there is no link."""
    assert Link().ticks(5, silent=True, counters=counters).state is LinkState.OUTAGE


# -- counters that misbehave


@pytest.mark.parametrize(
    "course",
    [
        lambda step: replace(INTERFACE, tx_bytes=step * 10_000, tx_dropped=step) if step % 3 else None,
        lambda step: replace(INTERFACE, tx_bytes=5 * 10**9),
        lambda step: replace(INTERFACE, tx_bytes=step * 10_000, state=list(InterfaceState)[step % 3]),
        lambda _: None,
    ],
    ids=["vanish", "stand still", "go down", "are gone"],
)
def test_counters_that_fail_are_no_evidence(course):
    """While a peer reports, counters that fail, here or at last there, change neither capacity nor kind nor state."""
    link = Link().measured()
    for step in range(60):
        trains = [FIRST] if step % 20 == 19 else ()
        estimate = link.tick(counters=course(step), trains=trains, rate=0.0 if step > 40 else 1e5)
        assert estimate.capacity_bytes_per_second == about(FIRST, 0.2)
        assert estimate.kind is CapacityKind.PEER
        assert estimate.state is LinkState.APP_LIMITED


# -- the radio


RADIO = 1e6  # bytes/s


def test_alone_the_radio_bounds_the_belief():
    """Before a peer has measured, the capacity is at most a share of the radio's bit rate, and the evidence says so."""
    link = Link()
    estimate = link.ticks(200, silent=True, radio=RADIO)
    assert (estimate.capacity_bytes_per_second, estimate.kind) == (parameters.RADIO_SHARE * RADIO, CapacityKind.RADIO)
    assert "radio" in estimate.evidence
    for fast_enough in (None, FIRST / parameters.RADIO_SHARE, 1e9):
        estimate = link.tick(silent=True, radio=fast_enough)
        assert (estimate.capacity_bytes_per_second, estimate.kind) == (FIRST, CapacityKind.CONFIGURED)
    estimate = Link().measured().tick(radio=RADIO)
    assert (estimate.capacity_bytes_per_second, estimate.kind) == (about(FIRST), CapacityKind.PEER)


# -- odd evidence


COUNTERS = st.one_of(
    st.none(),
    st.just(INTERFACE),
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


@examples(60)
@given(ODD_TICKS)
def test_odd_evidence_makes_no_nonsense(ticks):
    """At any observations, all numbers of the estimate are finite and not negative, and probes are few."""
    link = Link()
    for tick in ticks:
        estimate = link.tick(**tick)
        fields = (getattr(estimate, name) for name in estimate.__dataclass_fields__)
        assert all(0.0 <= value < math.inf for value in fields if isinstance(value, float | int)), estimate
        assert 0.0 <= estimate.available_bytes_per_second <= estimate.capacity_bytes_per_second
        assert estimate.evidence
    assert len(link.probes) <= 2 * len(ticks)


def test_another_overhead_of_a_packet_leaves_no_capacity_that_the_one_before_made():
    """With an overhead trains read higher; when a reload takes it back, the link is measured again."""
    link = Link().measured()
    link.estimator.reconfigure(LinkSettings(initial_capacity_bytes_per_second=FIRST, packet_overhead_s=0.0005))
    link.ticks(3, trains=[FIRST])
    assert link.ticks(3).capacity_bytes_per_second > 1.5 * FIRST
    link.estimator.reconfigure(LinkSettings(initial_capacity_bytes_per_second=FIRST))
    assert link.tick().capacity_bytes_per_second < 1.1 * FIRST
    assert link.ticks(3, trains=[FIRST]).capacity_bytes_per_second == about(FIRST)
