"""Silence: a dead peer or a dead link."""

from dataclasses import replace

import pytest

from arpd.estimate.silence import Silence
from arpd.model.interface import InterfaceState
from tests.sample_link import INTERFACE

TICK_S = 0.1


class Interface:
    """An interface that receives at given rates, and a clock."""

    def __init__(self):
        self.now_s = 50.0
        self.packets = 1000.0
        self.sent = 5e6
        self.dropped = 0
        self.silence = Silence()

    def receive(self, rate_hz, duration_s, *, is_usual=True, state=InterfaceState.UP, sends=1e5, backlog=None, drops=0):
        for _ in range(round(duration_s / TICK_S)):
            self.now_s += TICK_S
            self.packets += rate_hz * TICK_S
            self.sent += sends * TICK_S
            self.dropped += drops
            counters = replace(
                INTERFACE,
                tx_bytes=int(self.sent),
                rx_packets=int(self.packets),
                tx_packets=int(self.sent / 200),
                tx_dropped=int(self.dropped),
                state=state,
                backlog_bytes=backlog,
            )
            self.silence.note(self.now_s, counters, is_usual=is_usual)
        return self.silence.is_answered


@pytest.mark.parametrize(
    ("usual_hz", "lately_hz", "is_answered"), [(200, 190, True), (200, 120, True), (200, 40, False)]
)
def test_a_link_is_answered_where_about_as_much_arrives_as_usual(usual_hz, lately_hz, is_answered):
    """Acknowledgements continue when a peer dies, and stop when the link dies."""
    interface = Interface()
    interface.receive(usual_hz, 20.0)
    assert interface.receive(lately_hz, 5.0, is_usual=False) is is_answered


def test_a_silent_link_shows_within_a_few_ticks():
    """Packets that arrived before the silence count for 300 ms only."""
    interface = Interface()
    interface.receive(200, 20.0)
    assert interface.receive(0, 0.1, is_usual=False)
    assert not interface.receive(0, 0.2, is_usual=False)


def test_few_packets_tell_nothing():
    """Ten packets a second may all be the peer's own reports."""
    interface = Interface()
    interface.receive(10, 20.0)
    assert not interface.receive(10, 5.0, is_usual=False)


def test_an_interface_that_is_down_or_gone_answers_nothing():
    """Nothing counts while the interface is down, nor what it counted before that."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.silence.note(interface.now_s + 0.1, None, is_usual=False)
    assert not interface.silence.is_answered
    assert not interface.receive(200, 0.1, is_usual=False)
    assert interface.receive(200, 1.0, is_usual=False)
    assert not interface.receive(200, 0.1, is_usual=False, state=InterfaceState.DOWN)


@pytest.mark.parametrize(("lately_hz", "has_received_nothing"), [(0.0, True), (0.3, True), (0.8, False), (40.0, False)])
def test_a_link_is_silent_where_nobody_sends_anything(lately_hz, has_received_nothing):
    """A rare broadcast is silence; a host that reads anything sends more."""
    interface = Interface()
    interface.receive(200, 20.0)
    assert not interface.silence.has_received_nothing
    interface.receive(200, 0.6, is_usual=False)  # was under way
    interface.receive(lately_hz, 20.0, is_usual=False)
    assert interface.silence.has_received_nothing is has_received_nothing


def test_a_link_is_not_silent_until_the_peer_is_heard():
    """Silence lasts until a peer is heard, and ends at once."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.receive(0, 300.0, is_usual=False)
    assert interface.silence.has_received_nothing
    interface.receive(200, 0.1)
    assert not interface.silence.has_received_nothing


def test_a_link_without_any_peer_is_not_silent():
    """Before any peer was heard, silence says nothing."""
    interface = Interface()
    interface.receive(0, 60.0, is_usual=False)
    assert not interface.silence.has_received_nothing


@pytest.mark.parametrize("how", [{"backlog": 150_000}, {"drops": 40}])
@pytest.mark.parametrize(("rate", "is_cut"), [(0.0, True), (2_000.0, True), (12_500.0, False)])
def test_a_link_that_only_trickles_is_cut(how, rate, is_cut):
    """Next to none of the waiting packets leave, although some still arrive."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.receive(20, 10.0, is_usual=False, sends=rate, **how)
    assert not interface.silence.has_received_nothing
    assert interface.silence.is_cut is is_cut


@pytest.mark.parametrize("drops", [0, 0.1])
def test_a_host_that_has_nothing_to_send_is_not_cut(drops):
    """Few bytes leave and none wait; a rare drop does not count."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.receive(20, 10.0, is_usual=False, sends=500.0, backlog=0, drops=drops)
    assert not interface.silence.is_cut


@pytest.mark.parametrize("is_heard", [True, False])
def test_a_trickle_ends_when_the_link_is_back(is_heard):
    """A cut ends within a few ticks, even before the peer is heard."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.receive(20, 100.0, is_usual=False, sends=2_000.0, backlog=150_000)
    assert interface.silence.is_cut
    interface.receive(200, 0.2, is_usual=is_heard, backlog=100_000)
    assert not interface.silence.is_cut


def test_a_slow_link_on_which_no_peer_was_heard_is_not_cut():
    """Before any peer was heard, nobody knows that the link was better."""
    interface = Interface()
    interface.receive(20, 60.0, is_usual=False, sends=2_000.0, backlog=150_000)
    assert not interface.silence.is_cut
