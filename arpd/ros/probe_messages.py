"""Wire format of probes and of peers' reports: small, versioned, checked on arrival."""

from __future__ import annotations

import struct

from arpd.model.probing import PeerReport, ProbeHeader, Train

_PROBE = struct.Struct("<BBHHI")  # version, quiet time (10 ms), index in train, packets in train, train number
# Version, number of delays, number of trains, bytes of the name, interval s, rx bytes, rx packets, last probe, packets
# of all probes before it.
_REPORT = struct.Struct("<BBBBfIIII")
_DELAY = struct.Struct("<d")
_TRAIN = struct.Struct("<IffH")  # bytes, duration s, sent in s, packets
_PROBE_VERSION = 1
_REPORT_VERSION = 3
_MOST = 32  # delays or trains in one report
MOST_NAME_BYTES = 64
_MOST_INTERVAL_S = 60.0  # no report covers a longer one
_MOST_DELAY_S = 1e10  # two clocks differ by less, even when one of them was never set
_MOST_PACKETS = 1000  # in a train; arpd sends 24 (`arpd.estimate.probes`), its benchmark a hundred
_MOST_PACKET_BYTES = 65_536 + 1_000  # a datagram and its headers
_MOST_BYTES_PER_SECOND = 100e9 / 8  # no robot has a faster network interface
MOST_REPORT_BYTES = 1024  # of a serialized report


def encode_probe(header: ProbeHeader, *, payload_bytes: int) -> bytes:
    """Make one probe packet of ``payload_bytes`` (at least the header)."""
    quiet = min(255, round(header.quiet_s * 100))
    head = _PROBE.pack(_PROBE_VERSION, quiet, header.index, header.packets, header.train & 0xFFFFFFFF)
    return head.ljust(payload_bytes, b"\0")


def decode_probe(data: bytes) -> ProbeHeader:
    """Decode a probe packet from the bytes of its message; raise ValueError if it is none."""
    if not _PROBE.size <= len(data) <= _MOST_PACKET_BYTES or data[0] != _PROBE_VERSION:
        raise ValueError("not a probe of this version")
    _, quiet, index, packets, train = _PROBE.unpack_from(data)
    if not index < packets <= _MOST_PACKETS:
        raise ValueError(f"probe {index} of a train of {packets}; at most {_MOST_PACKETS} are allowed")
    return ProbeHeader(train, index, packets, quiet / 100)


def encode_report(report: PeerReport) -> bytes:
    """Make one report: 32 bytes and the name, with one delay; 14 more with a train."""
    delays, trains = report.delays_s[-_MOST:], report.trains[-_MOST:]
    # A name that is too long is cut between two characters.
    name = report.peer.encode()[:MOST_NAME_BYTES].decode(errors="ignore").encode()
    head = _REPORT.pack(
        _REPORT_VERSION,
        len(delays),
        len(trains),
        len(name),
        report.interval_s,
        min(report.rx_bytes, 2**32 - 1),
        min(report.rx_packets, 2**32 - 1),
        report.last_probe & 0xFFFFFFFF,
        (report.probe_packets or 0) & 0xFFFFFFFF,
    )
    packed = [_DELAY.pack(delay) for delay in delays]
    packed += [_TRAIN.pack(each.payload_bytes, each.duration_s, each.sent_s, each.packets) for each in trains]
    return b"".join([head, name, *packed])


def decode_report(data: bytes) -> PeerReport:
    """Decode a report from the bytes of its message; when it arrived, and how late, its reader knows.

    Raises ValueError if it is malformed, or its values are impossible.
    """
    if len(data) < _REPORT.size or data[0] != _REPORT_VERSION:
        raise ValueError("not a peer report of this version")
    _, delay_count, train_count, name_size, interval_s, *counts = _REPORT.unpack_from(data)
    rx_bytes, rx_packets, last_probe, probe_packets = counts
    delays_at = _REPORT.size + name_size
    trains_at = delays_at + delay_count * _DELAY.size
    if len(data) != trains_at + train_count * _TRAIN.size:
        raise ValueError("peer report of the wrong length")
    delays = tuple(value for (value,) in _DELAY.iter_unpack(data[delays_at:trains_at]))
    trains = tuple(
        Train(payload_bytes=size, duration_s=duration_s, sent_s=sent_s, packets=packets)
        for size, duration_s, sent_s, packets in _TRAIN.iter_unpack(data[trains_at:])
    )
    peer = data[_REPORT.size : delays_at].decode(errors="replace")
    # Written so that NaN fails too.
    is_possible = (
        0 < interval_s < _MOST_INTERVAL_S
        and rx_bytes <= _MOST_BYTES_PER_SECOND * interval_s
        and all(abs(delay) < _MOST_DELAY_S for delay in delays)
        and all(_is_possible(train) for train in trains)
    )
    if not is_possible or not 0 < name_size <= MOST_NAME_BYTES or not peer.isprintable():
        raise ValueError("peer report with an impossible name or impossible numbers")
    return PeerReport(
        peer=peer,
        received_at_s=0.0,
        interval_s=interval_s,
        rx_bytes=rx_bytes,
        rx_packets=rx_packets,
        last_probe=last_probe,
        delays_s=delays,
        probe_packets=probe_packets,
        trains=tuple(train for train in trains if train.duration_s > 0 and train.payload_bytes and train.packets),
    )


def _is_possible(train: Train) -> bool:
    return (
        0 <= train.duration_s < _MOST_INTERVAL_S
        and 0 <= train.sent_s < _MOST_INTERVAL_S
        and train.packets <= _MOST_PACKETS
        and train.payload_bytes <= _MOST_PACKETS * _MOST_PACKET_BYTES
        and (train.payload_bytes <= _MOST_BYTES_PER_SECOND * train.duration_s or not train.duration_s)
    )
