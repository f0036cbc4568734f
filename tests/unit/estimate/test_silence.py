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


@pytest.mark.parametrize(("lately_hz", "has_received_nothing"), [(0.0, True), (0.3, True), (0.8, False), (40.0, False)])
def test_a_link_is_silent_where_nobody_sends_anything(lately_hz, has_received_nothing):
    """A rare broadcast is silence; a host that reads anything sends more."""
    interface = Interface()
    interface.receive(200, 20.0)
    assert not interface.silence.has_received_nothing
    interface.receive(200, 0.6, is_usual=False)  # was under way
    interface.receive(lately_hz, 20.0, is_usual=False)
    assert interface.silence.has_received_nothing is has_received_nothing


@pytest.mark.parametrize("how", [{"backlog": 150_000}, {"drops": 40}])
@pytest.mark.parametrize(("rate", "is_cut"), [(0.0, True), (2_000.0, True), (12_500.0, False)])
def test_a_link_that_only_trickles_is_cut(how, rate, is_cut):
    """Next to none of the waiting packets leave, although some still arrive."""
    interface = Interface()
    interface.receive(200, 20.0)
    interface.receive(20, 10.0, is_usual=False, sends=rate, **how)
    assert not interface.silence.has_received_nothing
    assert interface.silence.is_cut is is_cut
