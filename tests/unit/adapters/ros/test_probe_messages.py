"""Probes and reports survive their wire format, and other bytes are refused."""

import math
import random
import struct
from dataclasses import replace

import pytest

pytest.importorskip("std_msgs", reason="ROS 2 is not installed")

from arpd.adapters.ros.probe_messages import ProbeHeader, decode_probe, decode_report, encode_probe, encode_report
from arpd.model.probing import PeerReport, Train

REPORT = PeerReport(
    peer="ceddp-3f2a",
    received_at_s=12.5,
    interval_s=0.125,
    rx_bytes=250_000,
    rx_packets=180,
    delays_s=(-1.7e9 + 0.001234567, 3.217),
    trains=(Train(payload_bytes=15_400, duration_s=0.0078125, sent_s=0.0009765625, packets=11),),
    last_probe=4711,
    probe_packets=12_345,
)


def decode(message, *, received_at_s=0.0):
    return decode_report(bytes(message.data), received_at_s=received_at_s)


def test_a_report_comes_back_as_it_was():
    """Counters, delays, trains with their departures, and the name of the peer."""
    assert decode(encode_report(REPORT), received_at_s=12.5) == REPORT


def test_a_report_of_the_version_before_is_understood():
    """An older peer's report has everything except the count of probe packets."""
    message = bytes(encode_report(REPORT).data)
    older = b"\x02" + message[1:20] + message[24:]
    assert decode_report(older, received_at_s=12.5) == replace(REPORT, probe_packets=None)
    for size in (0, 1, 19, 20, 23, len(older) - 1):
        with pytest.raises(ValueError, match="peer report"):
            decode_report(older[:size], received_at_s=0.0)


def test_a_count_of_packets_goes_round():
    """Packets are counted modulo 2^32."""
    assert decode(encode_report(replace(REPORT, probe_packets=2**32 + 5))).probe_packets == 5


def test_a_delay_keeps_its_microseconds_whatever_the_clocks_say():
    """Clocks half a century apart leave a delay as precise as any."""
    reports = (REPORT, replace(REPORT, delays_s=(REPORT.delays_s[0] + 1e-5,)))
    early, late = (decode(encode_report(report)).delays_s[0] for report in reports)
    assert late - early == pytest.approx(1e-5, abs=1e-6)


@pytest.mark.parametrize(("name", "size"), [("ceddp", 37), ("x", 33), ("ceddp-3f2a", 42)])
def test_a_report_is_as_short_as_its_name(name, size):
    """With one delay a report has 32 bytes and the name; ten a second and a train are far below 1 kB/s."""
    report = replace(REPORT, peer=name, delays_s=(0.1,), trains=())
    assert len(encode_report(report).data) == size
    assert 10 * size + 14 < 1000


def test_a_long_name_is_cut_between_characters():
    """A name is cut to 64 bytes, between two characters."""
    decoded = decode(encode_report(replace(REPORT, peer="x" + "é" * 40)))
    assert decoded.peer == "x" + "é" * 31


def test_more_than_a_report_holds_is_cut_to_the_newest():
    """Of a hundred delays and trains the last 32 are sent; counts beyond 32 bits are clipped."""
    delays = tuple(float(i) for i in range(100))
    report = replace(REPORT, delays_s=delays, trains=REPORT.trains * 100, rx_bytes=10**12)
    decoded = decode(encode_report(report))
    assert decoded.delays_s == delays[-32:]
    assert (len(decoded.trains), decoded.rx_bytes) == (32, 2**32 - 1)


def test_a_train_of_nothing_is_left_out():
    """A train without time, bytes or packets has no rate."""
    (whole,) = REPORT.trains
    empty = (replace(whole, duration_s=0.0), replace(whole, payload_bytes=0), replace(whole, packets=0))
    assert decode(encode_report(replace(REPORT, trains=(*empty, whole)))).trains == (whole,)


def test_a_report_of_another_version_is_refused():
    """Version 1, which had no departures, is refused."""
    message = encode_report(REPORT)
    message.data[0] = 1
    with pytest.raises(ValueError, match="version"):
        decode(message)


@pytest.mark.parametrize(
    "broken",
    [
        {"interval_s": 0.0},
        {"interval_s": 60.0},
        {"delays_s": (math.nan,)},
        {"delays_s": (1e300,)},
        {"delays_s": (-1e11,)},
        {"trains": (replace(REPORT.trains[0], packets=5000),)},
        {"trains": (replace(REPORT.trains[0], payload_bytes=10**9),)},
        {"trains": (replace(REPORT.trains[0], duration_s=1e30),)},
        {"peer": "ceddp\x1b[2J"},
        {"trains": (replace(REPORT.trains[0], duration_s=math.inf),)},
        {"trains": (replace(REPORT.trains[0], sent_s=-1.0),)},
        {"peer": ""},
    ],
)
def test_impossible_numbers_are_refused(broken):
    """Values that no peer can have measured are refused."""
    with pytest.raises(ValueError, match="impossible"):
        decode(encode_report(replace(REPORT, **broken)))


def test_any_other_bytes_are_refused_or_read_as_finite_numbers():
    """Any bytes give a report with finite numbers, or a ValueError."""
    chance = random.Random(5)
    whole = bytes(encode_report(REPORT).data)
    for _ in range(2000):
        data = bytearray(whole[: chance.randrange(len(whole) + 1)] if chance.random() < 0.5 else whole)
        for _ in range(chance.randrange(4)):
            if data:
                data[chance.randrange(len(data))] = chance.randrange(256)
        try:
            decoded = decode_report(bytes(data), received_at_s=0.0)
        except ValueError:
            continue
        assert all(math.isfinite(delay) for delay in decoded.delays_s)
        assert all(math.isfinite(train.rate_bytes_per_second) for train in decoded.trains)


def test_a_probe_says_its_place():
    """A probe's header comes back, and its payload has the requested size."""
    header = ProbeHeader(train=2**32 + 7, index=3, packets=12)
    message = encode_probe(header, payload_bytes=1300)
    assert len(message.data) == 1300
    assert decode_probe(bytes(message.data)) == replace(header, train=7)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x01",
        struct.pack("<BxHHI", 2, 0, 1, 1),
        struct.pack("<BxHHI", 1, 5, 5, 1),
        struct.pack("<BxHHI", 1, 5, 60000, 1),
    ],
)
def test_what_is_no_probe_is_refused(data):
    """A probe that is too short, of another version, or outside its own train is refused."""
    with pytest.raises(ValueError, match="probe"):
        decode_probe(data)
