"""Probes, trains and receiver reports, which measure the link."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Train:
    """Dispersion of one burst of back-to-back probe packets at the receiver.

    Parameters
    ----------
    payload_bytes : wire bytes of the counted packets, which are those after the first (bytes)
    duration_s : time between the arrivals of the first packet and the last one (s)
    packets : number of counted packets
    sent_s : time between the departures of the same two packets, by the sender's clock; 0 = unknown (s)
    """

    payload_bytes: int
    duration_s: float
    packets: int
    sent_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerReport:
    """One receiver report of ``arpd peer``, with its arrival time at the daemon.

    Parameters
    ----------
    peer : name of the reporting host
    received_at_s : arrival, by the daemon's monotonic clock (s)
    interval_s : time that the counters cover (s)
    rx_bytes, rx_packets : what the peer's link interface received in that time
    delays_s : one-way delays of the probe packets in that time; offset by an unknown clock difference (s)
    trains : bursts completed in that time
    last_probe : highest number of a probe whose first packet arrived, 0 = none or unknown
    probe_packets : packets of all earlier probes that arrived since the peer started, modulo 2^32; None = unknown
    return_delay_s : one-way delay of the report itself, offset like ``delays_s``; None = unknown (s)
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
class ClockOffset:
    """Difference of a peer's clock from this host's.

    Parameters
    ----------
    offset_s : the peer's clock less this host's; above 0 the peer's is ahead (s)
    uncertainty_s : most error of it, half a round trip (s)
    """

    offset_s: float
    uncertainty_s: float


@dataclass(frozen=True, slots=True)
class ProbeHeader:
    """Place of one probe packet in its train; a ping is a train of one.

    Parameters
    ----------
    train, index, packets : number of the train, place of the packet in it, and number of its packets
    quiet_s : longest time between two reports that the daemon wants (s)
    """

    train: int
    index: int
    packets: int
    quiet_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeRequest:
    """Burst that the estimator wants on the link.

    Parameters
    ----------
    packets, packet_bytes : number and payload of the packets, which leave back to back; a single one is a ping
    number : counts up from 1, so a report can name the last probe that arrived
    quiet_s : most time between two reports from now on; less than 0.25 s counts as 0.25 s (s)
    """

    packets: int
    packet_bytes: int
    number: int = 0
    quiet_s: float = 0.0
