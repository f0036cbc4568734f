"""Estimator on a simulated link: what it measures, and what must not disturb it."""

import math
from dataclasses import replace
from random import Random
from statistics import median

import pytest

from arpd.estimate.estimator import Estimator
from arpd.model.link import CapacityKind, LinkState
from arpd.model.relay import RelaySummary
from arpd.model.settings import GraphSettings, LinkSettings
from arpd.model.wire import wire_size
from arpd.sim.link import ForeignFlow, LinkModel, SimulatedLink
from arpd.sim.schedule import RateSchedule, RateStep
from arpd.sim.timeline import Alarm, Timeline
from arpd.sim.world import SimulatedWorld
from tests.sample_publishers import publisher

MBIT = 125_000.0  # bytes/s
TICK_S = 0.1
SAMPLE_BYTES, SAMPLE_PACKETS = 30_000, 22


def steps(*pairs):
    return RateSchedule(
        steps=tuple(RateStep(start_s=start_s, rate_bytes_per_second=mbit * MBIT) for start_s, mbit in pairs)
    )


def flows(loads):
    return tuple(
        ForeignFlow(start_s=start_s, end_s=end_s, rate_bytes_per_second=mbit * MBIT) for start_s, end_s, mbit in loads
    )


class Peer:
    """A peer with its own clock, which leads by ``clock_s``, and its share of the data."""

    def __init__(self, name="base", *, share=1.0, clock_s=0.0):
        self.name, self.share, self.clock_s = name, share, clock_s
        self.is_in_graph = self.is_heard = lambda _: True  # by run time


class Run:
    """An estimator on a link.

    Parameters
    ----------
    samples : load in samples of 30 kB: start s, end s, Mbit/s
    upload, way_back : smooth load from this host, and from the peer, likewise
    sees : what the daemon observes besides
    """

    def __init__(self, schedule, *, peers=None, samples=(), upload=(), way_back=(), model=None, seed=1, **sees):
        self.sees = sees
        self.timeline = Timeline(0.0)
        self.random = Random(f"{seed} samples")
        self.up, down = (
            SimulatedLink(self.timeline, schedule, model=model or LinkModel(), random=Random(f"{seed} {way}"))
            for way in ("up", "down")
        )
        for load in samples:
            self.send(0, *load)
        for link, loads in ((self.up, upload), (down, way_back)):
            for flow in flows(loads):
                flow.play(self.timeline, link)
        self.peers = peers or [Peer()]
        self.worlds = [
            SimulatedWorld(
                self.timeline,
                up=self.up,
                down=down,
                publishers=(),
                random=Random(f"{seed} peer {place}"),
                graph=GraphSettings(sensing_topics=1),  # what crosses stands for a topic
                on_report=self.wake,
            )
            for place in range(len(self.peers))
        ]
        self.estimator = Estimator(LinkSettings())
        self.course = []  # run time, estimate
        self.ticked_s = 0.0
        self.alarm = Alarm(self.timeline, self.tick)
        self.alarm.set(TICK_S)

    def send(self, sent, start_s, end_s, mbit):
        """Send a sample now and then the next one, a little late at random."""
        at_s = start_s + (sent + 0.2 * self.random.random()) * SAMPLE_BYTES / (mbit * MBIT)
        if at_s < end_s:
            self.timeline.at(at_s, lambda: self.leave(sent, start_s, end_s, mbit))

    def leave(self, sent, start_s, end_s, mbit):
        self.up.send(SAMPLE_BYTES, SAMPLE_PACKETS, lambda: None)
        self.send(sent + 1, start_s, end_s, mbit)

    def until(self, end_s):
        """Run up to a time, and return the last estimate."""
        self.timeline.run_until(end_s)
        return self.course[-1][1]

    def wake(self):
        """Tick right after a report, as the daemon does."""
        self.alarm.set(min(self.alarm.when_s, max(self.timeline.now_s + 0.001, self.ticked_s + 0.02)))

    def tick(self):
        self.ticked_s = now_s = self.timeline.now_s
        self.alarm.set(now_s + TICK_S)
        run_s = now_s
        seen = [world.observe(now_s) for world in self.worlds]
        reports = [
            self.as_seen(report, peer)
            for peer, observation in zip(self.peers, seen, strict=True)
            if peer.is_heard(run_s)
            for report in observation.reports
        ]
        observation = replace(
            seen[0],
            reports=tuple(sorted(reports, key=lambda report: report.received_at_s)),
            peers=sum(peer.is_in_graph(run_s) for peer in self.peers),
            **self.sees,
        )
        self.course.append((run_s, self.estimator.update(observation)))
        for request in self.estimator.wanted_probes(now_s, is_short=False):
            for peer, world in zip(self.peers, self.worlds, strict=True):
                if peer.is_in_graph(run_s):
                    world.probe(request)

    def as_seen(self, report, peer):
        return replace(
            report,
            peer=peer.name,
            rx_bytes=round(report.rx_bytes * peer.share),
            delays_s=tuple(delay_s + peer.clock_s for delay_s in report.delays_s),
        )

    def estimates(self, since_s=0.0, until_s=math.inf):
        return [estimate for run_s, estimate in self.course if since_s <= run_s < until_s]

    def states(self, since_s=0.0, until_s=math.inf):
        return {estimate.state for estimate in self.estimates(since_s, until_s)}

    def right(self, mbit, since_s, until_s=math.inf, *, within=0.3):
        """Return the part of the estimates within some part of the true capacity; single trains may err."""
        seen = [estimate.capacity_bytes_per_second / (mbit * MBIT) for estimate in self.estimates(since_s, until_s)]
        return sum(abs(each - 1.0) <= within for each in seen) / len(seen)

    def delivery(self, since_s, until_s):
        """Return the median delivery, which leaves out trains (Mbit/s)."""
        return median(each.delivery_rate_bytes_per_second for each in self.estimates(since_s, until_s)) / MBIT


NEARLY_ALWAYS, MOSTLY = 0.9, 0.7
TROUBLE = {LinkState.OUTAGE, LinkState.DRAINING}

# -- links that rest


# -- capacities that change


@pytest.mark.parametrize("part", [0.4, 0.6, 0.75, 0.9])
@pytest.mark.parametrize("seed", [1, 2])
def test_hole_1_a_queue_that_stays_is_a_busy_link(part, seed):
    """A fall to any part of the capacity is known within 1.5 s, also if the queue neither grows nor goes."""
    mbit = 20 * part
    run = Run(steps((0, 20), (6, mbit)), samples=((0, 5.8, 10), (5.8, 6.4, 19), (6.4, 12, mbit)), seed=seed)
    run.until(12.0)
    assert run.right(20, 3.0, 6.0) > NEARLY_ALWAYS
    assert run.right(mbit, 7.5, within=0.15) == 1.0


TWO_ENDS = {"relay": RelaySummary(), "publishers": (publisher("/arpd_relay_robot", "/image", payload_bytes=921_600.0),)}


@pytest.mark.parametrize("mbit", [5, 20])
def test_an_image_in_paced_chunks_shows_no_capacity(mbit):
    """Two ends pace their chunks, so no ping meets a queue at any load, and the link is not taken for more."""
    run = Run(steps((0, mbit)), upload=((1, 30, 0.93 * mbit),), **TWO_ENDS)
    run.until(30.0)
    assert run.right(mbit, 5.0, within=0.1) == 1.0


@pytest.mark.parametrize("seed", [3, 14])
def test_a_short_hidden_queue_shows_a_fall(seed):
    """Two ends let 50 ms wait at most; though this host cannot see them wait, a fall is known within a second."""
    hidden = LinkModel(queue_bytes=0, firmware_bytes=256_000)
    run = Run(steps((0, 20), (6, 5)), upload=((0, 6.03, 18.6), (6.03, 12, 5)), model=hidden, seed=seed, **TWO_ENDS)
    run.until(12.0)
    assert run.right(20, 3.0, 6.0) > NEARLY_ALWAYS
    assert run.right(5, 7.0, within=0.15) == 1.0


@pytest.mark.parametrize(("share", "mbit"), [(0.4, 5), (0.05, 9)])
def test_an_upload_to_another_host_is_no_fall(share, mbit):
    """Bytes for another host than the peer say nothing about the link."""
    run = Run(steps((0, 10)), upload=((0, 12, mbit),), peers=[Peer(share=share)])
    run.until(12.0)
    assert run.right(10, 2.0) > NEARLY_ALWAYS
    assert not run.states(2.0) & TROUBLE


def test_a_queue_on_the_way_back_is_no_fall():
    """Reports that wait for a busy way back say nothing about the way there."""
    bursts = tuple((at_s, at_s + 0.6, 14) for at_s in range(5, 20, 3))
    run = Run(steps((0, 10)), samples=((0, 20, 3),), way_back=bursts)
    run.until(20.0)
    assert not run.states(3.0) & TROUBLE
    assert run.right(10, 3.0) > NEARLY_ALWAYS


# -- several peers


@pytest.mark.parametrize("leaves", [False, True])
@pytest.mark.parametrize("which", [0, 1])
def test_a_peer_that_goes_changes_nothing_while_another_reports(leaves, which):
    """What peers receive adds up; when one dies, even if copies still go to it, there is no outage and no fall."""
    peers = [Peer("a", share=0.4, clock_s=5.0), Peer("b", share=0.6, clock_s=-1e6)]
    run = Run(steps((0, 10)), samples=((0, 20, 2),), peers=peers)
    run.peers[which].is_heard = lambda run_s: not 6.0 <= run_s < 12.0
    if leaves:
        run.peers[which].is_in_graph = run.peers[which].is_heard
    assert run.until(18.0).kind is CapacityKind.PEER
    assert not run.states(2.0) & TROUBLE
    assert run.right(10, 2.0) > MOSTLY
    assert run.delivery(8.0, 12.0) == pytest.approx(2 * run.peers[1 - which].share, rel=0.3)
    for since_s in (2.0, 14.0):
        assert run.delivery(since_s, since_s + 4.0) == pytest.approx(2, rel=0.3)


def test_the_longest_queue_counts_and_all_of_them_silent_is_an_outage():
    """A queue counts when one peer reports it, and the link is out only when no peer reports."""
    run = Run(steps((0, 10)), samples=((0, 5, 4), (5, 8, 14)), peers=[Peer("a", share=0.5), Peer("b", share=0.5)])
    run.peers[0].is_heard = lambda run_s: run_s < 5.0
    run.peers[1].is_heard = lambda run_s: run_s < 8.0
    run.until(9.0)
    assert max(estimate.queue_delay_s for estimate in run.estimates(6.5)) > 0.15
    assert run.states(6.5, 8.0) <= {LinkState.CONGESTED, LinkState.DRAINING}
    assert run.states(8.7) == {LinkState.OUTAGE}


# -- what a packet costs, and what measuring costs


@pytest.mark.parametrize(("mbit", "overhead_s"), [(2, 500e-6), (5, 1e-3), (20, 0.0), (20, 200e-6), (50, 250e-6)])
def test_rmax_is_right_for_small_and_for_large_messages(mbit, overhead_s):
    """The link time k·t_ovh + s/C is right for messages of 10 bytes and of 30 kB."""
    run = Run(steps((0, mbit)), model=LinkModel(packet_overhead_s=overhead_s))
    estimate = run.until(25.0)
    for payload_bytes in (10, 30_000):
        size, packets = wire_size(payload_bytes, rate_hz=10.0)
        true_s = packets * overhead_s + size / (mbit * MBIT)
        seen_s = packets * estimate.packet_overhead_s + size / estimate.capacity_bytes_per_second
        assert seen_s == pytest.approx(true_s, rel=0.2)
