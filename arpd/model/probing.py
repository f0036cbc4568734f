"""What goes over the link to measure it, and what comes back: probes, trains, receiver reports."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Train:
    """Dispersion of one burst of back-to-back probe packets at the receiver.

    Parameters
    ----------
    payload_bytes : wire bytes of the packets counted, which are those after the first (bytes)
    duration_s : arrival of the last packet counted minus arrival of the first (s)
    packets : packets whose bytes are counted
    sent_s : departures of the same two packets, on the sender's clock; 0 = not told (s)
    """

    payload_bytes: int
    duration_s: float
    packets: int
    sent_s: float = 0.0

    @property
    def rate_bytes_per_second(self) -> float:
        """Capacity this train saw: bytes after the first / (t_last - t_first), docs/design.md, The estimator."""
        return self.payload_bytes / self.duration_s if self.duration_s > 0 else math.inf


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerReport:
    """One receiver report from ``arpd peer``, with the moment it reached the daemon.

    Parameters
    ----------
    peer : name of the reporting host
    received_at_s : daemon's monotonic clock (s)
    interval_s : time covered by the counters (s)
    rx_bytes, rx_packets : what the peer's link interface received in that time
    delays_s : one-way delays of the probe packets in that time; offset by an unknown clock difference (s)
    trains : bursts completed in that time
    last_probe : highest number of a probe whose first packet has arrived, 0 = none or not told
    probe_packets : packets of all probes before that one which have arrived since the peer started, modulo 2^32;
        None = not told, by a peer of an older version
    return_delay_s : the report's own one-way delay, offset like ``delays_s``; None = not told (s)
    """

    peer: str
    received_at_s: float
    interval_s: float
    rx_bytes: int
    rx_packets: int
    delays_s: tuple[float, ...] = ()
    trains: tuple[Train, ...] = ()
    last_probe: int = 0
    probe_packets: int | None = None
    return_delay_s: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeRequest:
    """A burst the estimator wants on the link.

    Parameters
    ----------
    packets, packet_bytes : that many packets of that payload, back to back; a single one is a ping
    number : counts up from 1, so that a report can say how far the probes have come
    quiet_s : how long the peer may let reports be apart from now on; less than a quarter of a second is that (s)
    """

    packets: int
    packet_bytes: int
    number: int = 0
    quiet_s: float = 0.0
