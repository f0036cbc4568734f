"""Clocks of the peers, from probes and reports."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.estimate.peer_clocks import PeerClocks
from arpd.model.probing import ClockOffset, PeerReport


def report(at_s=100.0, *, ahead_s=0.0, there_s=0.002, back_s=0.002, peer="base"):
    """Return a report of a peer whose clock is ahead, after ways of these lengths."""
    return PeerReport(
        peer=peer,
        received_at_s=at_s,
        interval_s=0.1,
        rx_bytes=0,
        rx_packets=0,
        delays_s=(there_s + ahead_s + 0.5, there_s + ahead_s),
        return_delay_s=back_s - ahead_s,
    )


@given(
    ahead_s=st.floats(-1e5, 1e5),
    ways=st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 2.0)), min_size=1, max_size=30),
)
def test_the_true_offset_is_within_the_uncertainty(ahead_s, ways):
    """It holds however unequal the two ways are, and the shortest round trip is the uncertainty."""
    clocks = PeerClocks()
    for index, (there_s, back_s) in enumerate(ways):
        clocks.note(report(index * 0.1, ahead_s=ahead_s, there_s=there_s, back_s=back_s))
    found = clocks.offsets(len(ways) * 0.1)["base"]
    assert abs(found.offset_s - ahead_s) <= found.uncertainty_s + 1e-6
    assert found.uncertainty_s == pytest.approx(min(sum(way) for way in ways) / 2, abs=1e-6)


def test_the_window_forgets():
    """A short round trip counts for 30 s; a silent peer has no offset."""
    clocks = PeerClocks()
    clocks.note(report(0.0, there_s=0.001, back_s=0.001))
    clocks.note(report(1.0, there_s=0.008, back_s=0.008))
    assert clocks.offsets(30.0)["base"].uncertainty_s == pytest.approx(0.001)
    assert clocks.offsets(30.1) == {}


def test_a_clock_that_is_set_counts_at_once():
    """The offset before it contradicts the next report, and is forgotten although its round trip was shorter."""
    clocks = PeerClocks()
    clocks.note(report(0.0, there_s=0.001, back_s=0.001, ahead_s=3.0))
    clocks.note(report(0.1, there_s=0.004, back_s=0.004, ahead_s=0.0))
    assert clocks.offsets(0.1)["base"] == ClockOffset(offset_s=0.0, uncertainty_s=0.004)
    clocks.note(report(0.2, there_s=-5.0))  # set between probe and report: no round trip is below zero
    assert clocks.offsets(0.2) == {}
