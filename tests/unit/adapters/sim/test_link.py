"""The link in virtual time: rate, overhead, loss, hidden queue, and conservation of packets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.sim.aggregation import _MOST_AIR_S, AggregatingBottleneck
from arpd.adapters.sim.air import Air
from arpd.adapters.sim.bottleneck import MOST_UNCOUNTED
from arpd.adapters.sim.foreign import Contention, contended
from arpd.adapters.sim.link import LinkModel, SimulatedLink
from arpd.adapters.sim.loss import GilbertElliott, Losses, LossStep
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.service import Service
from arpd.adapters.sim.timeline import Alarm, Timeline
from arpd.adapters.sim.trace import read_trace

ORIGIN_S = 1000.0
FRAME_BYTES = 1514
MBIT = 125_000.0
END_S = 1.5  # of a link that is kept busy


def schedule_of(*steps):
    return RateSchedule(steps=tuple(RateStep(start_s=s, rate_bytes_per_second=r) for s, r in steps))


def carried(schedule, from_s, until_s):
    """Return the bytes that the schedule allows between two moments of run time, by plain summation."""
    edges = sorted({from_s, until_s, *(s.start_s for s in schedule.steps if from_s < s.start_s < until_s)})
    return sum((end - start) * schedule.rate_at(max(0.0, start)) for start, end in pairwise(edges))


@dataclass
class Bench:
    """A link under test, and the run time at which each datagram was sent and arrived."""

    schedule: RateSchedule
    model: LinkModel
    seed: int = 1
    sent: dict[int, tuple[float, float]] = field(default_factory=dict)
    arrived: dict[int, float] = field(default_factory=dict)

    def __post_init__(self):
        self.timeline = Timeline(ORIGIN_S)
        self.link = SimulatedLink(
            self.timeline, self.schedule, origin_s=ORIGIN_S, model=self.model, random=Random(self.seed)
        )

    @property
    def now_s(self):
        return self.timeline.now_s - ORIGIN_S

    def send(self, wire_bytes, packets=1):
        number = len(self.sent)
        self.sent[number] = (self.now_s, wire_bytes)
        return self.link.send(wire_bytes, packets, lambda: self.arrived.__setitem__(number, self.now_s))

    def run_until(self, t_s):
        self.timeline.run_until(ORIGIN_S + t_s)

    def offer(self, offered):
        """Send datagrams, each after a gap, and run until all have arrived."""
        for gap_s, packet_bytes, packets in offered:
            self.run_until(self.now_s + gap_s)
            self.send(packet_bytes * packets, packets)
        self.run_until(self.now_s + 60.0)

    def saturate(self, wire_bytes, until_s, *, every_s):
        """Send packets at a fixed interval."""
        while self.now_s < until_s:
            self.send(wire_bytes)
            self.run_until(self.now_s + every_s)


rates = st.one_of(st.just(0.0), st.floats(1e4, 1e7))
schedules = st.tuples(
    st.floats(1e4, 1e7), st.lists(st.tuples(st.floats(0.01, 1.0), rates), max_size=4), st.floats(1e4, 1e7)
).map(
    lambda t: schedule_of(
        (0.0, t[0]),
        *((sum(gap for gap, _ in t[1][: i + 1]), rate) for i, (_, rate) in enumerate(t[1])),
        (sum(gap for gap, _ in t[1]) + 0.5, t[2]),
    )
)
LOSSLESS = {
    "delay_s": st.floats(0.0, 0.05),
    "queue_bytes": st.integers(0, 100_000),
    "packet_overhead_s": st.sampled_from([0.0, 0.0001, 0.003]),
    "aggregate_packets": st.sampled_from([1, 4, 64]),
    "firmware_bytes": st.sampled_from([0, 5_000, 60_000]),
}
lossless_models = st.builds(LinkModel, **LOSSLESS)
models = st.builds(
    LinkModel,
    loss=st.sampled_from([0.0, 0.2]),
    outages=st.sampled_from([(), ((0.2, 0.5),)]),
    losses=st.sampled_from([(), (LossStep(start_s=0.3, loss=0.5), LossStep(start_s=0.6, loss=0.0))]),
    bursts=st.sampled_from([None, GilbertElliott(good_s=0.1, bad_s=0.05)]),
    **LOSSLESS,
)
sends = st.lists(st.tuples(st.floats(0.0, 0.05), st.integers(60, FRAME_BYTES), st.integers(1, 20)), max_size=40)


# -- on any link


@settings(max_examples=150, deadline=None)
@given(schedules, models, sends, st.integers(0, 5))
def test_packets_are_conserved_and_queues_are_bounded(schedule, model, offered, seed):
    """Every packet is dropped, lost or received; counters never fall, and the host's queue keeps within its size."""
    bench = Bench(schedule, model, seed)
    link = bench.link
    before = 0.0, 0.0
    for gap_s, packet_bytes, packets in offered:
        bench.run_until(bench.now_s + gap_s)
        bench.send(packet_bytes * packets, packets)
        assert link.backlog_bytes <= model.queue_bytes + FRAME_BYTES + 1e-3
        counters = link.sent_bytes, link.received_bytes()
        assert all(now >= then - 1e-3 for now, then in zip(counters, before, strict=True))
        assert link.received_bytes() <= link.sent_bytes + 1e-3
        before = counters
    bench.run_until(bench.now_s + 60.0)
    assert link.sent_packets + link.dropped_packets == sum(packets for _, _, packets in offered)
    assert link.sent_packets == link.received_packets + link.lost_packets
    assert link.backlog_bytes == pytest.approx(0.0, abs=1e-3)
    assert link.queue_delay_s == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=100, deadline=None)
@given(schedules, lossless_models, sends)
def test_a_link_that_loses_nothing_delivers_every_byte_it_took(schedule, model, offered):
    """Without loss the far interface receives every byte that the near one sent."""
    bench = Bench(schedule, model)
    bench.offer(offered)
    assert bench.link.lost_packets == 0
    assert bench.link.received_bytes() == pytest.approx(bench.link.sent_bytes, abs=1e-3)


@settings(max_examples=150, deadline=None)
@given(schedules, models, sends, st.integers(0, 5))
def test_arrivals_are_in_order_and_never_early(schedule, model, offered, seed):
    """Datagrams arrive in order, and no earlier than the link can have carried them and all before them."""
    bench = Bench(schedule, model, seed)
    bench.offer(offered)
    assert list(bench.arrived) == sorted(bench.arrived)
    for number, at_s in bench.arrived.items():
        sent_s, size = bench.sent[number]
        first_byte_s, last_byte_s = sent_s + model.packet_overhead_s, at_s - model.delay_s
        assert carried(schedule, first_byte_s, max(first_byte_s, last_byte_s)) >= size - 1e-2
    for (one, one_s), (other, other_s) in pairwise(bench.arrived.items()):
        since_s = max(one_s - model.delay_s, 0.0)
        if model.aggregate_packets == 1 and bench.sent[other][0] <= since_s:
            carried_bytes = carried(schedule, since_s, max(since_s, other_s - model.delay_s))
            assert carried_bytes >= bench.sent[other][1] - 1e-2, (one, other)


@settings(max_examples=100, deadline=None)
@given(schedules, sends)
def test_transmissions_of_one_packet_without_overhead_are_the_fluid_link(schedule, offered):
    """The bottleneck with events equals the one without, if transmissions have one packet and no overhead."""
    fluid = Bench(schedule, LinkModel(queue_bytes=10**9))
    other = Bench(schedule, LinkModel(queue_bytes=10**9))
    other.link._bottleneck = AggregatingBottleneck(
        other.timeline,
        Service(schedule, ORIGIN_S),
        Losses(loss=0.0, steps=(), bursts=None, outages=(), origin_s=ORIGIN_S, random=Random(1)),
        delay_s=0.002,
        room_bytes=10**9,
        overhead_s=0.0,
        aggregate_packets=1,
        air=Air(Random(1)),
        station="robot",
    )
    ends: list[list[float]] = []
    for bench in (fluid, other):
        ends.append([])
        for gap_s, packet_bytes, packets in offered:
            bench.run_until(bench.now_s + gap_s)
            ends[-1].append(bench.send(packet_bytes * packets, packets))
            ends[-1].append(bench.link.backlog_bytes)
            ends[-1].append(bench.link.queue_delay_s)
        bench.run_until(bench.now_s + 60.0)
    assert other.arrived == pytest.approx(fluid.arrived, abs=1e-6)
    assert ends[1] == pytest.approx(ends[0], abs=1e-2)


# -- rate


def test_a_span_without_rate_holds_everything_back():
    """A datagram sent while the rate is 0 arrives when the link can have carried it afterwards."""
    bench = Bench(schedule_of((0.0, 1000.0), (1.0, 0.0), (3.0, 1000.0)), LinkModel(delay_s=0.5))
    bench.run_until(0.9)
    bench.send(200)
    bench.run_until(2.0)
    bench.send(100)
    assert bench.link.queue_delay_s == pytest.approx(1.2)
    bench.run_until(10.0)
    assert bench.arrived == pytest.approx({0: 3.6, 1: 3.7})


@pytest.mark.parametrize("model", [LinkModel(), LinkModel(packet_overhead_s=0.001, aggregate_packets=8)])
def test_a_link_that_stops_for_ever_delivers_nothing_more(model):
    """With a last rate of 0 the wait is infinite, and the queue fills up and drops the rest."""
    bench = Bench(schedule_of((0.0, 1000.0), (1.0, 0.0)), model)
    bench.run_until(2.0)
    ends = [bench.send(1500) for _ in range(300)]
    bench.run_until(100.0)
    assert bench.arrived == {}
    assert ends[0] == bench.link.queue_delay_s == math.inf
    assert model.queue_bytes < bench.link.backlog_bytes <= model.queue_bytes + FRAME_BYTES
    assert bench.link.dropped_packets == 300 - bench.link.sent_packets


def test_the_truth_about_the_capacity_is_the_rate_of_bytes():
    """The capacity is the schedule's rate at the moment, without the overhead of packets."""
    bench = Bench(schedule_of((0.0, 1000.0), (1.0, 0.0), (2.0, 500.0)), LinkModel(packet_overhead_s=0.01))
    seen = []
    for t_s in (0.0, 0.5, 1.0, 1.5, 2.0, 100.0):
        bench.run_until(t_s)
        seen.append(bench.link.capacity_bytes_per_second)
    assert seen == [1000.0, 1000.0, 0.0, 0.0, 500.0, 500.0]


@settings(max_examples=60, deadline=None)
@given(schedules, st.lists(st.floats(0.0, 6.0), min_size=1, max_size=20))
def test_service_is_the_integral_of_the_rate_and_its_inverse(schedule, moments):
    """`by` is the integral of the rate and `when` its first inverse, in any order of questions."""
    service = Service(schedule, ORIGIN_S)
    for t_s in moments:
        size = service.by(ORIGIN_S + t_s)
        assert size == pytest.approx(carried(schedule, 0.0, t_s), abs=1e-3)
        first_s = service.when(size + 1.0) - ORIGIN_S
        assert carried(schedule, t_s, first_s) == pytest.approx(1.0, abs=1e-2)
        # Right beside a step the sum with the origin may round to its other side.
        if min(abs(t_s - step.start_s) for step in schedule.steps) > 1e-6:
            assert service.rate_at(ORIGIN_S + t_s) == schedule.rate_at(t_s)


def test_a_link_that_plays_a_trace_carries_what_the_trace_carried(tmp_path):
    """A busy link delivers 1500 bytes per line and turn of a recording."""
    path = tmp_path / "trace"
    path.write_text("".join(f"{moment}\n" for moment in (3, 3, 9, 40, 41, 41, 41, 77, 130)))
    trace = read_trace(path).lasting(10 * 0.13)
    bench = Bench(trace.rates, LinkModel(delay_s=0.0))
    bench.saturate(1500, trace.duration_s - 0.01, every_s=0.005)
    bench.run_until(trace.duration_s)
    assert bench.link.received_bytes() == pytest.approx(10 * 9 * 1500)


@pytest.mark.parametrize("model", [{}, {"packet_overhead_s": 0.0002, "aggregate_packets": 16, "firmware_bytes": 9000}])
def test_the_same_seed_gives_the_same_arrivals(model):
    """Equal seeds give equal arrivals to the last bit, and other seeds give others."""

    def play(seed):
        bench = Bench(
            schedule_of((0.0, 2e5), (1.0, 0.0), (1.5, 1e5)),
            LinkModel(loss=0.05, bursts=GilbertElliott(good_s=0.3, bad_s=0.1), **model),
            seed,
        )
        bench.saturate(1000, 3.0, every_s=0.004)
        return bench.arrived, bench.link.received_bytes(), bench.link.lost_packets

    assert play(1) == play(1)
    assert play(1) != play(2)


@pytest.mark.parametrize(
    ("model", "uncounted"),
    [({}, "_crossings"), ({"packet_overhead_s": 0.0001}, "_arriving")],
    ids=["fluid", "overhead"],
)
def test_a_long_run_that_nobody_counts_keeps_no_list_of_it(model, uncounted):
    """The link counts old arrivals and forgets their details."""
    bench = Bench(schedule_of((0.0, 20 * MBIT)), LinkModel(**model))
    bench.saturate(100, 5.0, every_s=0.001)
    assert len(getattr(bench.link._bottleneck, uncounted)) <= MOST_UNCOUNTED
    bench.run_until(6.0)
    assert bench.link.received_packets == len(bench.sent) > 4000


# -- overhead, aggregates, firmware


@pytest.mark.parametrize("packet_bytes", [100, 400, 1514])
def test_overhead_costs_small_packets_most(packet_bytes):
    """Without aggregation the long-run goodput of s-byte packets is s/(t_ovh + s/C)."""
    overhead_s, rate = 0.0005, 20 * MBIT
    bench = Bench(schedule_of((0.0, rate)), LinkModel(packet_overhead_s=overhead_s, queue_bytes=20_000))
    bench.saturate(packet_bytes, END_S, every_s=0.8 * packet_bytes / rate)
    goodput = bench.link.received_bytes() / END_S
    assert goodput == pytest.approx(packet_bytes / (overhead_s + packet_bytes / rate), rel=0.01)


@pytest.mark.parametrize("aggregate_packets", [2, 8, 64])
def test_aggregates_share_the_overhead(aggregate_packets):
    """An aggregate of n packets costs one overhead, so goodput nears C as n grows, within the limit of 802.11."""
    overhead_s, rate, packet_bytes = 0.0005, 20 * MBIT, 1000
    model = LinkModel(packet_overhead_s=overhead_s, aggregate_packets=aggregate_packets)
    bench = Bench(schedule_of((0.0, rate)), model)
    bench.saturate(packet_bytes, END_S, every_s=0.5 * packet_bytes / rate)
    size = min(aggregate_packets, int(_MOST_AIR_S * rate / packet_bytes)) * packet_bytes
    goodput = bench.link.received_bytes() / END_S
    assert goodput == pytest.approx(size / (overhead_s + size / rate), rel=0.02)
    assert goodput < rate * _MOST_AIR_S / (_MOST_AIR_S + overhead_s)


@pytest.mark.parametrize(("rate", "aggregates"), [(1 * MBIT, [1] * 6), (20 * MBIT, [1, 5]), (5 * MBIT, [1, 3, 2])])
def test_no_transmission_is_longer_than_the_radio_may_send(rate, aggregates):
    """On a slow link few packets share a transmission (aPPDUMaxTime), and one alone may take longer."""
    bench = Bench(schedule_of((0.0, rate)), LinkModel(packet_overhead_s=0.0005, aggregate_packets=64))
    for _ in range(6):
        bench.send(1000)
    bench.run_until(10.0)
    at_once: dict[float, int] = {}
    for arrived_s in bench.arrived.values():
        at_once[arrived_s] = at_once.get(arrived_s, 0) + 1
    assert list(at_once.values()) == aggregates


def test_an_aggregate_arrives_all_at_once():
    """An idle link sends at once; packets that wait when it is free again go and arrive together."""
    bench = Bench(schedule_of((0.0, 1e5)), LinkModel(packet_overhead_s=0.001, aggregate_packets=3, delay_s=0.0))
    for _ in range(6):
        bench.send(100)
    bench.run_until(10.0)
    assert bench.arrived == pytest.approx({0: 0.002, 1: 0.006, 2: 0.006, 3: 0.006, 4: 0.009, 5: 0.009})


def test_a_datagram_may_be_cut_by_an_aggregate():
    """A datagram that two aggregates share arrives with its last fragment."""
    bench = Bench(schedule_of((0.0, 1e5)), LinkModel(packet_overhead_s=0.001, aggregate_packets=3, delay_s=0.0))
    bench.send(500, 5)
    bench.run_until(0.0041)
    assert bench.arrived == {}
    assert bench.link.received_bytes() == 300.0
    bench.run_until(10.0)
    assert bench.arrived == pytest.approx({0: 0.007})


@pytest.mark.parametrize("model", [{}, {"packet_overhead_s": 0.01, "aggregate_packets": 4}])
def test_firmware_hides_what_it_holds(model):
    """The host counts bytes in the firmware as sent and sees no backlog, but packets wait for them."""
    bench = Bench(schedule_of((0.0, 1000.0)), LinkModel(firmware_bytes=5000, queue_bytes=3000, **model))
    for _ in range(5):
        bench.send(1000)
    assert bench.link.backlog_bytes == 0.0
    assert bench.link.sent_bytes == 5000.0
    assert bench.link.queue_delay_s >= 5.0
    bench.send(1000)
    assert bench.link.backlog_bytes == 1000.0
    assert bench.link.sent_bytes == 5000.0
    for _ in range(9):
        bench.send(1000)
    assert bench.link.dropped_packets == 6
    assert bench.link.backlog_bytes == 4000.0


# -- loss


def loss_ratio(bench, from_s, until_s, *, every_s=0.001):
    bench.run_until(from_s)
    before = bench.link.lost_packets, bench.link.sent_packets
    bench.saturate(100, until_s, every_s=every_s)
    return (bench.link.lost_packets - before[0]) / (bench.link.sent_packets - before[1])


def test_scheduled_loss_comes_on_top_of_the_constant_one():
    """Constant and scheduled loss are independent: 10 % and 50 % are 55 %."""
    model = LinkModel(loss=0.1, losses=(LossStep(start_s=5.0, loss=0.5), LossStep(start_s=10.0, loss=1.0)))
    bench = Bench(schedule_of((0.0, 20 * MBIT)), model)
    assert loss_ratio(bench, 0.0, 4.9) == pytest.approx(0.1, abs=0.02)
    assert loss_ratio(bench, 5.0, 9.9) == pytest.approx(0.55, abs=0.03)
    assert loss_ratio(bench, 10.0, 12.0) == 1.0
    assert [model.loss_ratio(at_s) for at_s in (0.0, 5.0, 10.0)] == pytest.approx([0.1, 0.55, 1.0])


def test_bursts_have_their_mean_durations():
    """In the long run the link is bad for bad_s / (good_s + bad_s) of the time, for bad_s on average."""
    bench = Bench(schedule_of((0.0, 20 * MBIT)), LinkModel(bursts=GilbertElliott(good_s=0.3, bad_s=0.03)))
    arrived = []
    end_s = 150.0
    while bench.now_s < end_s:
        number = len(bench.sent)
        bench.send(100)
        bench.run_until(bench.now_s + 0.003)
        arrived.append(number in bench.arrived)
    spells = sum(was and not now for was, now in pairwise(arrived))
    assert arrived.count(False) / len(arrived) == pytest.approx(0.03 / 0.33, rel=0.2)
    assert arrived.count(False) * 0.003 / spells == pytest.approx(0.03, rel=0.2)


def test_bursts_come_whatever_is_sent():
    """The same moments are bad under other traffic, and other moments with another seed."""

    def bad_moments(seed, more):
        model = LinkModel(loss=0.0, bursts=GilbertElliott(good_s=0.2, bad_s=0.05))
        bench = Bench(schedule_of((0.0, 20 * MBIT)), model, seed)
        found = []
        while bench.now_s < 5.0:
            for _ in range(more):
                bench.send(1)
            number = len(bench.sent)
            bench.send(100)
            bench.run_until(round(bench.now_s + 0.01, 6))
            found.append(number in bench.arrived)
        return found

    alone = bad_moments(1, more=0)
    assert not all(alone)
    assert bad_moments(1, more=3) == alone
    assert bad_moments(2, more=0) != alone


def test_a_good_state_may_lose_a_little():
    """Both states of Elliott's model may lose a part of the packets."""
    bursts = GilbertElliott(good_s=1.0, bad_s=1.0, good_loss=0.1, bad_loss=0.5)
    bench = Bench(schedule_of((0.0, 20 * MBIT)), LinkModel(bursts=bursts))
    assert loss_ratio(bench, 0.0, 200.0, every_s=0.01) == pytest.approx(0.3, abs=0.06)
    assert LinkModel(bursts=bursts).loss_ratio(0.0) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LinkModel(loss=1.1), "loss: 1.1 is not a probability"),
        (lambda: LinkModel(delay_s=-1.0), "delay_s -1.0: must be 0 or more"),
        (lambda: LinkModel(delay_s=math.nan), "delay_s nan: must be 0 or more"),
        (lambda: LinkModel(aggregate_packets=0), "aggregate_packets 0: must be 1 or more"),
        (lambda: LinkModel(firmware_bytes=-1), "firmware_bytes -1: must be 0 or more"),
        (lambda: LossStep(start_s=-1.0, loss=0.0), "zero or later"),
        (lambda: LossStep(start_s=1.0, loss=math.nan), "loss step at 1 s: nan is not a probability"),
        (lambda: GilbertElliott(good_s=0.0, bad_s=1.0), "good_s 0.0: a mean duration must be above zero"),
        (lambda: GilbertElliott(good_s=1.0, bad_s=1.0, bad_loss=2.0), "bad_loss: 2.0 is not a probability"),
        (lambda: LinkModel(losses=(LossStep(start_s=1.0, loss=0.0),) * 2), "loss step at 1 s comes after"),
        (lambda: Contention(start_s=2.0, end_s=1.0, share=0.5), "from 2.0 s to 1.0 s"),
        (lambda: Contention(start_s=0.0, end_s=1.0, share=1.5), "share 1.5: must be from 0 to 1"),
    ],
)
def test_a_link_that_cannot_be_is_refused(make, message):
    """The message names the parameter and its range."""
    with pytest.raises(ValueError, match=message):
        make()


# -- another station


def test_another_station_takes_its_share_of_the_air():
    """Stations take the sum of their shares of the rate while they send, and never more than all of it."""
    left = contended(
        schedule_of((0.0, 1000.0), (10.0, 600.0)),
        [Contention(start_s=5.0, end_s=15.0, share=0.25), Contention(start_s=12.0, end_s=20.0, share=0.8)],
    )
    assert [left.rate_at(t_s) for t_s in (0.0, 4.9, 5.0, 10.0, 12.0, 15.0, 20.0)] == pytest.approx(
        [1000.0, 1000.0, 750.0, 450.0, 0.0, 120.0, 600.0]
    )


def test_without_other_stations_a_schedule_is_what_it_was():
    """Without other stations the schedule stays the same."""
    schedule = schedule_of((0.0, 1000.0), (10.0, 0.0), (11.0, 5.0))
    assert contended(schedule, []) == schedule


# -- virtual time


def test_events_run_in_order_of_time_then_of_planning():
    """The clock shows the moment of each event, and an event in the past does not turn it back."""
    timeline, seen = Timeline(10.0), []

    def note(name):
        seen.append((name, timeline.now_s))

    for name, when_s in (("c", 12.0), ("a", 11.0), ("d", 12.0), ("b", 5.0)):
        timeline.at(when_s, partial(note, name))
    timeline.run_until(12.0)
    assert seen == [("b", 10.0), ("a", 11.0)]
    timeline.run_until(20.0)
    assert seen[2:] == [("c", 12.0), ("d", 12.0)]
    assert timeline.now_s == 20.0


def test_an_alarm_rings_once_at_the_moment_set_last():
    """An alarm runs once at the moment set last, and can be set again."""
    timeline, rung = Timeline(0.0), []
    alarm = Alarm(timeline, lambda: rung.append(timeline.now_s))
    for when_s in (3.0, 1.0, 2.0):
        alarm.set(when_s)
    timeline.run_until(10.0)
    assert rung == [2.0]
    assert alarm.when_s == math.inf
    alarm.set(5.0)
    timeline.run_until(20.0)
    assert rung == [2.0, 10.0]
