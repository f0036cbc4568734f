"""Silence: a dead peer or a dead link."""

from dataclasses import replace
from itertools import count

import pytest

from arpd.estimate.silence import Silence
from arpd.model.interface import InterfaceState
from arpd.model.link import CapacityKind, LinkState
from tests.sample_link import INTERFACE
from tests.unit.estimate.test_estimator import FIRST, Link, sent_alone


@pytest.mark.parametrize("how", [{"backlog_bytes": 150_000}, {"tx_dropped": 40}])
@pytest.mark.parametrize(("rate", "is_cut"), [(0.0, True), (2_000.0, True), (12_500.0, False)])
def test_a_link_that_only_trickles_is_cut(how, rate, is_cut):
    """Next to none of the waiting packets leave, although some still arrive."""
    silence, sent = Silence(), 5e6
    for tick in range(300):
        is_usual = tick < 200
        sent += 0.1 * (1e5 if is_usual else rate)
        received = 20 * tick if is_usual else 4000 + 2 * (tick - 200)
        trouble = {} if is_usual else {**how, "tx_dropped": how.get("tx_dropped", 0) * (tick - 200)}
        counters = replace(INTERFACE, tx_bytes=int(sent), rx_packets=received, tx_packets=int(sent / 200), **trouble)
        silence.note(50.0 + 0.1 * tick, counters, is_usual=is_usual)
    assert silence.is_cut is is_cut


@pytest.mark.parametrize("counters", [None, replace(INTERFACE, state=InterfaceState.DOWN)])
def test_a_peer_on_another_way_is_no_peer_of_this_link(counters):
    """A peer that is heard while the interface is down is not missed when the interface comes."""
    silence = Silence()
    for tick in range(200):
        silence.note(50.0 + 0.1 * tick, counters if tick < 20 else INTERFACE, is_usual=tick < 20)
    assert not silence.is_cut


@pytest.mark.parametrize(("delay_s", "is_out"), [(0.02, False), (2.0, True)])
def test_behind_a_queue_of_seconds_a_peer_is_late_and_not_dead(delay_s, is_out):
    """Although as many packets as usual still arrive, a peer that was heard behind such a queue is not given up."""
    link, received = Link().measured(), count(INTERFACE.rx_packets, 10)
    link.ticks(20, delay_s=delay_s, rate=1e4)
    for tick in range(70):
        counters = replace(INTERFACE, tx_bytes=round(link.sent), rx_packets=next(received))
        estimate = link.tick(counters=counters, delay_s=delay_s, rate=1e4, silent=tick >= 45)
    assert (estimate.state is LinkState.OUTAGE) is is_out
    assert (estimate.queue_delay_s > 1.0) is is_out


def test_who_sends_no_probes_takes_the_pace_of_the_reports():
    """A peer that another daemon, or one before, has told to report rarely is no outage between two reports."""
    link = Link(capacity_bytes_per_second=FIRST)
    link.tick(interval_s=0.7)
    for _ in range(5):
        assert link.ticks(6, silent=True).state is not LinkState.OUTAGE
        link.tick(interval_s=0.7)
    assert link.ticks(17, silent=True).state is LinkState.OUTAGE


def test_trains_for_a_peer_that_returns_wait_for_each_other():
    """Where one takes three seconds, the next one leaves only after it: trains that pile up are a queue."""
    link = Link()
    assert sent_alone(link, 50, backlog=50_000).kind is CapacityKind.LOCAL
    link.probes.clear()
    link.ticks(30, delay_s=3.0)
    assert [probe.packets > 1 for _, probe in link.probes].count(True) <= 1
    link.ticks(20)
    assert [probe.packets > 1 for _, probe in link.probes].count(True) > 2
