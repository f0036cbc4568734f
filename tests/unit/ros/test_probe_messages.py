"""Probes and reports survive their wire format, and other bytes are refused."""

import math
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.probing import PeerReport, ProbeHeader, Train
from arpd.ros.probe_messages import decode_probe, decode_report, encode_probe, encode_report
from tests.examples import examples

REPORT = PeerReport(
    peer="base-3f2a",
    received_at_s=0.0,
    interval_s=0.125,
    rx_bytes=250_000,
    rx_packets=180,
    delays_s=(-1.7e9 + 0.001234567, 3.217),
    trains=(Train(payload_bytes=15_400, duration_s=0.0078125, sent_s=0.0009765625, packets=11),),
    last_probe=4711,
    probe_packets=12_345,
)


def test_a_report_comes_back_as_it_was():
    """Counters, delays, trains with their departures, and the name of the peer."""
    assert decode_report(encode_report(REPORT)) == REPORT


def test_a_report_of_another_version_or_length_is_refused():
    """The first byte tells the version, and the counts tell the length."""
    message = encode_report(REPORT)
    for broken in (b"\x02" + message[1:], *(message[:size] for size in (0, 1, 23, 24, len(message) - 1))):
        with pytest.raises(ValueError, match="peer report"):
            decode_report(broken)


@given(st.binary(max_size=60), st.integers(0, 200), st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255))))
@examples(200)
def test_any_other_bytes_are_refused_or_read_as_finite_numbers(noise, size, spoils):
    """Any bytes give a report with finite numbers and a probe with a place in its train, or a ValueError."""
    for message in (encode_report(REPORT), encode_probe(ProbeHeader(train=7, index=3, packets=12), payload_bytes=64)):
        spoilt = bytearray(message)
        for index, value in spoils:
            spoilt[index % len(spoilt)] = value
        for data in (noise, bytes(spoilt), bytes(spoilt[:size])):
            with suppress(ValueError):
                decoded = decode_report(data)
                assert decoded.interval_s > 0
                assert all(math.isfinite(delay) for delay in decoded.delays_s)
                assert all(math.isfinite(train.payload_bytes / train.duration_s) for train in decoded.trains)
            with suppress(ValueError):
                header = decode_probe(data)
                assert 0 <= header.index < header.packets


def test_a_probe_says_its_place():
    """A probe's header comes back, and its payload has the requested size."""
    header = ProbeHeader(train=2**32 + 7, index=3, packets=12)
    message = encode_probe(header, payload_bytes=1300)
    assert len(message) == 1300
    assert decode_probe(message) == replace(header, train=7)
