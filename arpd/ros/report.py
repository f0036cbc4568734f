"""Wire format of probes and of the peer's receiver reports: small, versioned, checked on arrival."""

from __future__ import annotations

import math
import struct
from array import array
from dataclasses import dataclass
from typing import Any

from std_msgs.msg import UInt8MultiArray

from arpd.probing import PeerReport, Train

_PROBE = struct.Struct("<BxHHI")  # version, index in train, packets in train, train number
_REPORT = struct.Struct("<BBBxfIII32s")  # version, delays, trains, interval s, rx bytes, rx packets, last probe, peer
_DELAY = struct.Struct("<d")
_TRAIN = struct.Struct("<IfH")  # bytes after the first, duration s, packets
_VERSION = 1
_MOST = 32  # delays or trains in one report


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeHeader:
    """Place of one probe packet in its train; a ping is a train of one."""

    train: int
    index: int
    packets: int


def encode_probe(header: ProbeHeader, *, payload_bytes: int) -> Any:
    """Make one probe packet of ``payload_bytes`` (at least the header)."""
    head = _PROBE.pack(_VERSION, header.index, header.packets, header.train & 0xFFFFFFFF)
    return UInt8MultiArray(data=array("B", head.ljust(payload_bytes, b"\0")))


def decode_probe(message: Any) -> ProbeHeader:
    """Read a probe packet; raises ValueError if it is none of ours."""
    data = bytes(message.data[: _PROBE.size])
    if len(data) < _PROBE.size or data[0] != _VERSION:
        raise ValueError("not a probe of this version")
    _, index, packets, train = _PROBE.unpack(data)
    if not index < packets:
        raise ValueError(f"probe {index} of a train of {packets}")
    return ProbeHeader(train=train, index=index, packets=packets)


def encode_report(report: PeerReport) -> Any:
    """Make the message of one receiver report; about 60 bytes with one delay."""
    delays, trains = report.delays_s[-_MOST:], report.trains[-_MOST:]
    head = _REPORT.pack(
        _VERSION,
        len(delays),
        len(trains),
        report.interval_s,
        min(report.rx_bytes, 2**32 - 1),
        min(report.rx_packets, 2**32 - 1),
        report.last_probe & 0xFFFFFFFF,
        report.peer.encode()[:32],
    )
    body = b"".join(_DELAY.pack(delay) for delay in delays)
    body += b"".join(_TRAIN.pack(train.payload_bytes, train.duration_s, min(train.packets, 65535)) for train in trains)
    return UInt8MultiArray(data=array("B", head + body))


def decode_report(message: Any, *, received_at_s: float) -> PeerReport:
    """Read a receiver report.

    Raises
    ------
    ValueError
        If it is malformed or says something impossible.
    """
    data = bytes(message.data)
    if len(data) < _REPORT.size or data[0] != _VERSION:
        raise ValueError("not a peer report of this version")
    _, delay_count, train_count, interval_s, rx_bytes, rx_packets, last_probe, name = _REPORT.unpack_from(data)
    if len(data) != _REPORT.size + delay_count * _DELAY.size + train_count * _TRAIN.size:
        raise ValueError("peer report of the wrong length")
    offset = _REPORT.size + delay_count * _DELAY.size
    delays = tuple(value for (value,) in _DELAY.iter_unpack(data[_REPORT.size : offset]))
    trains = tuple(
        Train(payload_bytes=size, duration_s=duration_s, packets=packets)
        for size, duration_s, packets in _TRAIN.iter_unpack(data[offset:])
    )
    numbers = [interval_s, *delays, *(train.duration_s for train in trains)]
    if not all(math.isfinite(number) for number in numbers) or not 0 < interval_s < 60:
        raise ValueError("peer report with impossible numbers")
    return PeerReport(
        peer=name.rstrip(b"\0").decode(errors="replace"),
        received_at_s=received_at_s,
        interval_s=interval_s,
        rx_bytes=rx_bytes,
        rx_packets=rx_packets,
        last_probe=last_probe,
        delays_s=delays,
        trains=tuple(train for train in trains if train.duration_s > 0),
    )
