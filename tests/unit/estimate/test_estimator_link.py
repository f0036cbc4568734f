"""Estimator on a simulated link: what it measures, and what must not disturb it."""

import math
from dataclasses import replace
from functools import lru_cache
from random import Random
from statistics import median

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.sim.foreign import ForeignFlow
from arpd.adapters.sim.link import LinkModel, SimulatedLink
from arpd.adapters.sim.loss import GilbertElliott
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.timeline import Alarm, Timeline
from arpd.adapters.sim.world import SimulatedWorld
from arpd.estimate.estimator import Estimator
from arpd.model.link import CapacityKind, LinkState
from arpd.model.settings import GraphSettings, LinkSettings
from arpd.model.wire import wire_size

MBIT = 125_000.0  # bytes/s
TICK_S = 0.1
START_S = 1000.0


def steps(*pairs):
    return RateSchedule(
        steps=tuple(RateStep(start_s=start_s, rate_bytes_per_second=mbit * MBIT) for start_s, mbit in pairs)
    )


class Peer:
    """A peer with its own clock, which leads by ``clock_s`` of the run time, and its share of the data."""

    def __init__(self, name="ceddp", *, share=1.0, clock_s=lambda _: 0.0):
        self.name, self.share, self.clock_s = name, share, clock_s
        self.is_in_graph = self.is_heard = lambda _: True  # by run time


class Run:
    """An estimator on a link, with load to the peers."""

    def __init__(self, schedule, *, peers=None, loads=(), model=None, link=None, seed=1):
        self.timeline = Timeline(START_S)
        model = model or LinkModel()
        up, down = (
            SimulatedLink(self.timeline, schedule, origin_s=START_S, model=model, random=Random(f"{seed} {way}"))
            for way in ("up", "down")
        )
        for start_s, end_s, mbit in loads:
            flow = ForeignFlow(start_s=start_s, end_s=end_s, rate_bytes_per_second=mbit * MBIT)
            flow.play(self.timeline, up, origin_s=START_S)
        self.up = up
        self.peers = peers or [Peer()]
        self.worlds = [
            SimulatedWorld(
                self.timeline,
                up=up,
                down=down,
                publishers=(),
                random=Random(f"{seed} peer {place}"),
                graph=GraphSettings(),
                on_report=self.wake,
            )
            for place in range(len(self.peers))
        ]
        self.estimator = Estimator(link or LinkSettings())
        self.course = []  # run time, estimate
        self.ticked_s = START_S
        self.alarm = Alarm(self.timeline, self.tick)
        self.alarm.set(START_S + TICK_S)

    def until(self, end_s):
        """Run up to a time, and return the last estimate."""
        self.timeline.run_until(START_S + end_s)
        return self.course[-1][1]

    def wake(self):
        """Tick right after a report, as the daemon does."""
        self.alarm.set(min(self.alarm.when_s, max(self.timeline.now_s + 0.001, self.ticked_s + 0.02)))

    def tick(self):
        self.ticked_s = now_s = self.timeline.now_s
        self.alarm.set(now_s + TICK_S)
        run_s = now_s - START_S
        seen = [world.observe(now_s) for world in self.worlds]
        reports = [
            self.as_seen(report, peer, run_s)
            for peer, observation in zip(self.peers, seen, strict=True)
            if peer.is_heard(run_s)
            for report in observation.reports
        ]
        observation = replace(
            seen[0],
            reports=tuple(sorted(reports, key=lambda report: report.received_at_s)),
            peers=sum(peer.is_in_graph(run_s) for peer in self.peers),
        )
        self.course.append((run_s, self.estimator.update(observation)))
        for request in self.estimator.wanted_probes(now_s):
            for peer, world in zip(self.peers, self.worlds, strict=True):
                if peer.is_in_graph(run_s):
                    world.probe(request)

    def as_seen(self, report, peer, run_s):
        ahead_s = peer.clock_s(run_s)
        return replace(
            report,
            peer=peer.name,
            rx_bytes=round(report.rx_bytes * peer.share),
            delays_s=tuple(delay_s + ahead_s for delay_s in report.delays_s),
        )

    def estimates(self, since_s=0.0, until_s=math.inf):
        return [estimate for run_s, estimate in self.course if since_s <= run_s < until_s]

    def sampled(self, since_s):
        """Return the capacity ten times a second, at any times of ticks (Mbit/s)."""
        out, course = [], iter(self.course)
        last_s, last = next(course)
        moments = round((self.course[-1][0] - since_s) * 10)
        for moment in range(moments):
            while last_s < since_s + moment / 10:
                last_s, last = next(course)
            out.append(last.capacity_bytes_per_second / MBIT)
        return out

    def delivery(self, since_s, until_s):
        """Return the median delivery, which leaves out trains (bytes/s)."""
        return median(each.delivery_rate_bytes_per_second for each in self.estimates(since_s, until_s))

    def states(self, since_s=0.0, until_s=math.inf):
        return {estimate.state for estimate in self.estimates(since_s, until_s)}


# -- clocks

CHANGING = steps((0, 20), (6, 5), (14, 20))
LOADS = ((0, 7, 10), (7.5, 24, 2))  # a queue from the fall until the load follows


def changing(clock_s=lambda _: 0.0):
    run = Run(CHANGING, loads=LOADS, peers=[Peer(clock_s=clock_s)])
    run.until(24.0)
    return run


@lru_cache(maxsize=1)
def reference():
    return changing()


def test_it_finds_the_capacity_and_follows_it():
    """A fall from 20 to 5 Mbit/s is known within 1.5 s, and the return within 9 s."""
    run = reference()
    truth = {(4.0, 6.0): 20.0, (7.5, 14.0): 5.0, (23.0, 24.0): 20.0}
    for (since_s, until_s), mbit in truth.items():
        seen = [estimate.capacity_bytes_per_second / MBIT for estimate in run.estimates(since_s, until_s)]
        assert min(seen) > 0.85 * mbit
        assert max(seen) < 1.1 * mbit


@pytest.mark.parametrize("drift", [-200e-6, 200e-6])
def test_a_clock_that_drifts_does_not_matter(drift):
    """A drift of 200 ppm adds 2 ms to a delay over its 10 s window, which is no queue."""
    run = changing(lambda run_s: drift * run_s)
    assert run.sampled(23.0) == pytest.approx(reference().sampled(23.0), rel=0.05)
    differs = [abs(a - b) > 0.1 * b for a, b in zip(run.sampled(0.1), reference().sampled(0.1), strict=True)]
    assert sum(differs) * 0.1 <= 2.0  # a rise may come a train earlier or later
    assert LinkState.OUTAGE not in run.states()


@pytest.mark.parametrize("step_s", [-1e6, -0.2, 0.2, 60.0])
@pytest.mark.parametrize("at_s", [3.0, 6.3, 9.05, 14.0])
def test_a_clock_that_jumps_makes_neither_a_fall_nor_an_outage(step_s, at_s):
    """A clock that is set at any moment, in either direction, disturbs at most the queue delay."""
    run = changing(lambda run_s: step_s * (run_s >= at_s))
    assert LinkState.OUTAGE not in run.states()
    for estimate in run.estimates(at_s, 6.0):
        assert estimate.capacity_bytes_per_second > 0.9 * 20 * MBIT
    for estimate in run.estimates(at_s):
        assert estimate.capacity_bytes_per_second > 0.9 * 5 * MBIT
    assert run.sampled(23.0) == pytest.approx([20.0] * len(run.sampled(23.0)), rel=0.15)


@settings(deadline=None, max_examples=8)
@given(st.lists(st.tuples(st.floats(2.0, 6.0), st.floats(-10.0, 10.0)), max_size=5))
def test_a_clock_that_never_rests_does_not_matter(jumps):
    """On a steady link any number of jumps changes no capacity and makes no outage."""
    run = Run(
        steps((0, 10)),
        loads=((0, 8, 5),),
        peers=[Peer(clock_s=lambda run_s: sum(step_s for at_s, step_s in jumps if run_s >= at_s))],
    )
    run.until(7.0)
    assert run.sampled(2.0) == pytest.approx([10.0] * len(run.sampled(2.0)), rel=0.05)
    assert not run.states(2.0) & {LinkState.OUTAGE, LinkState.DRAINING}


# -- several peers


def two(*, second=None, mbit=5):
    """Return a run on 10 Mbit/s, with a load to two peers with different clocks."""
    peers = [Peer("a", share=0.4, clock_s=lambda _: 5.0), second or Peer("b", share=0.6, clock_s=lambda _: -1e6)]
    return Run(steps((0, 10)), loads=((0, 20, mbit),), peers=peers)


def test_what_several_peers_receive_adds_up():
    """The delivery is that of all peers and the capacity that of the link, at any clocks of the peers."""
    run = two()
    run.until(8.0)
    for estimate in run.estimates(4.0):
        assert estimate.delivery_rate_bytes_per_second == pytest.approx(5 * MBIT, rel=0.15)
        assert estimate.capacity_bytes_per_second == pytest.approx(10 * MBIT, rel=0.1)
        assert estimate.kind is CapacityKind.PEER
    assert not run.states(2.0) & {LinkState.OUTAGE, LinkState.DRAINING}


@pytest.mark.parametrize(("leaves", "mbit"), [(False, 0.5), (False, 5), (True, 0.5)])
@pytest.mark.parametrize("which", [0, 1])
def test_a_peer_that_goes_changes_nothing_while_another_reports(leaves, mbit, which):
    """When one of two peers dies, even if copies still go to it, or leaves, there is no outage and no fall."""
    run = two(mbit=mbit)
    run.peers[which].is_heard = lambda run_s: not 6.0 <= run_s < 12.0
    if leaves:
        run.peers[which].is_in_graph = run.peers[which].is_heard
    run.until(18.0)
    assert not run.states(2.0) & {LinkState.OUTAGE, LinkState.DRAINING}
    for estimate in run.estimates(2.0):
        assert estimate.capacity_bytes_per_second == pytest.approx(10 * MBIT, rel=0.2)
    share = run.peers[1 - which].share
    assert run.delivery(8.0, 12.0) == pytest.approx(mbit * MBIT * share, rel=0.2)
    assert run.delivery(14.0, 18.0) == pytest.approx(mbit * MBIT, rel=0.2)


def test_the_longest_queue_counts():
    """A queue counts when one peer reports it, even if the other one is silent."""
    run = Run(steps((0, 10)), loads=((0, 5, 4), (5, 8, 14)), peers=[Peer("a", share=0.5), Peer("b", share=0.5)])
    run.peers[0].is_heard = lambda run_s: run_s < 5.0
    run.until(8.0)
    assert max(estimate.queue_delay_s for estimate in run.estimates(6.5)) > 0.15
    assert run.states(6.5) <= {LinkState.CONGESTED, LinkState.DRAINING}


def test_all_of_them_silent_is_an_outage():
    """The link is out only when no peer reports."""
    run = two()
    run.peers[0].is_heard = lambda run_s: run_s < 5.0
    run.peers[1].is_heard = lambda run_s: run_s < 7.0
    run.until(8.0)
    assert LinkState.OUTAGE not in run.states(2.0, 7.2)
    assert run.states(7.7) == {LinkState.OUTAGE}


@pytest.mark.parametrize("mbit", [1, 5])
def test_two_peers_of_one_name_make_neither_a_fall_nor_a_queue(mbit):
    """Cloned hosts share a name and not a clock: the capacity stays, and the second report on a ping does not count."""
    run = two(second=Peer("a", share=0.6, clock_s=lambda _: -3.0), mbit=mbit)
    run.until(12.0)
    assert not run.states(2.0) & {LinkState.OUTAGE, LinkState.DRAINING}
    for estimate in run.estimates(2.0):
        assert estimate.capacity_bytes_per_second == pytest.approx(10 * MBIT, rel=0.15)
        assert estimate.queue_delay_s < 0.3


# -- what a packet costs


@pytest.mark.parametrize(
    ("mbit", "overhead_s"),
    [(2, 0.0), (2, 500e-6), (5, 200e-6), (5, 1e-3), (20, 0.0), (20, 50e-6), (20, 200e-6), (50, 0.0), (50, 250e-6)],
)
def test_rmax_is_right_for_small_and_for_large_messages(mbit, overhead_s):
    """The link time k·t_ovh + s/C is right for messages of 10 bytes and of 30 kB."""
    run = Run(steps((0, mbit)), model=LinkModel(packet_overhead_s=overhead_s))
    estimate = run.until(25.0)
    for payload_bytes in (10, 30_000):
        size, packets = wire_size(payload_bytes, rate_hz=10.0)
        true_s = packets * overhead_s + size / (mbit * MBIT)
        seen_s = packets * estimate.packet_overhead_s + size / estimate.capacity_bytes_per_second
        assert seen_s == pytest.approx(true_s, rel=0.1)


# -- what it costs


@pytest.mark.parametrize("mbit", [5, 10, 50])
def test_a_minute_of_measuring_costs_one_per_cent(mbit):
    """After the first trains, probes and reports together take one per cent of the link."""
    run = Run(steps((0, mbit)))
    run.until(15.0)
    (world,) = run.worlds
    before = world.probes_sent()[1] + world.report_bytes
    run.until(75.0)
    assert world.probes_sent()[1] + world.report_bytes - before <= 0.01 * mbit * MBIT * 60.0


@pytest.mark.parametrize("delay_s", [0.03, 0.08])
@pytest.mark.parametrize("step_s", [-7.0, 0.3, 60.0])
def test_a_clock_that_jumps_is_no_queue_on_a_long_way_either(delay_s, step_s):
    """On a link whose round trip is longer than a standing queue, a step of the clock is no queue."""
    run = Run(
        steps((0, 10)),
        loads=((0, 10, 1),),
        model=LinkModel(delay_s=delay_s),
        peers=[Peer(clock_s=lambda run_s: step_s * (run_s >= 5.0))],
    )
    run.until(9.0)
    before = run.estimates(4.0, 5.0)[-1].capacity_bytes_per_second
    for estimate in run.estimates(5.0):
        assert estimate.capacity_bytes_per_second == pytest.approx(before, rel=0.15)
        assert estimate.queue_delay_s < 0.1


@pytest.mark.parametrize(("share", "mbit"), [(0.4, 5), (0.2, 5), (0.05, 9)])
def test_an_upload_to_another_host_is_no_fall(share, mbit):
    """Bytes for another host than the peer say nothing about the link."""
    run = Run(steps((0, 10)), loads=((0, 12, mbit),), peers=[Peer(share=share)])
    run.until(12.0)
    for estimate in run.estimates(2.0):
        assert estimate.capacity_bytes_per_second == pytest.approx(10 * MBIT, rel=0.2)
    assert not run.states(2.0) & {LinkState.OUTAGE, LinkState.DRAINING}


def test_a_fall_does_not_forget_what_a_packet_costs():
    """Between a fall and the next train the overhead stays."""
    run = Run(steps((0, 20), (20, 5)), loads=((0, 30, 10),), model=LinkModel(packet_overhead_s=200e-6))
    run.until(22.0)
    known = run.estimates(18.0, 20.0)[-1].packet_overhead_s
    assert known == pytest.approx(200e-6, rel=0.5)
    assert LinkState.DRAINING in run.states(20.0)
    assert all(estimate.packet_overhead_s > 0.5 * known for estimate in run.estimates(20.0))


# -- what is lost

BURSTS = GilbertElliott(good_s=2.0, bad_s=0.2)


@pytest.mark.parametrize(
    "model", [LinkModel(), LinkModel(loss=0.1), LinkModel(bursts=BURSTS)], ids=["none", "random", "bursts"]
)
def test_the_loss_is_that_of_the_link(model):
    """The loss that two peers show agrees with what the link lost of the same probes."""
    run = Run(steps((0, 5)), model=model, peers=[Peer("a"), Peer("b")], seed=3)
    lost = []
    for end_s in range(10, 41):
        estimate = run.until(float(end_s))
        lost.append((run.up.sent_packets, run.up.received_packets, estimate.loss_ratio))
    measured = [ratio for *_, ratio in lost[20:] if ratio is not None]
    true = [
        1.0 - (received - received_then) / (sent - sent_then)
        for (sent_then, received_then, _), (sent, received, ratio) in zip(lost, lost[20:], strict=False)
        if ratio is not None
    ]
    assert len(measured) >= 5
    assert sum(measured) / len(measured) == pytest.approx(sum(true) / len(true), abs=0.02)
    assert min(measured) >= 0.0
    if model == LinkModel():
        assert max(measured) == 0.0
    else:
        assert min(measured) > 0.0


def test_a_queue_is_no_loss():
    """Probes that wait half a second behind other traffic do not count as lost."""
    run = Run(steps((0, 5)), loads=((12, 14, 6),))
    run.until(20.0)
    assert max(estimate.queue_delay_s for estimate in run.estimates(12.0)) > 0.2
    assert {estimate.loss_ratio for estimate in run.estimates(5.0)} == {0.0}
