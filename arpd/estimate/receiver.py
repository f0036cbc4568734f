"""Receiver of probes at the peer: delays, trains, and the time to report them."""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import NamedTuple

from arpd.model.probing import PeerReport, ProbeHeader, Train
from arpd.model.wire import probe_wire_bytes

# A report answers a probe; `BUSY_S` and `QUIET_S` only bound how long news waits without one.
PROMPT_S = 0.02  # least time between two reports; bytes that arrive before a ping's report blur those after the ping
BUSY_S = 0.12  # until the report of traffic that is worth one when a ping is late
WORTH_BYTES = 10_000  # received since the last report are worth one
QUIET_S = 0.25  # between reports while no probe arrives; longer silence is an outage (`arpd.estimate.estimator`)
LONGEST_QUIET_S = 2.0  # even if a ping asks for more

_LONGEST_S = 59.0  # covered by one report
_MOST_KEPT = 32  # delays and trains until the next report; a report holds no more
_MOST_LOST = 0.1  # of a train's packets
_LEAST_EDGE = 4  # packets, or half of a short train; a shorter edge is jitter
_SENT_AS_SLOWLY = 0.7  # of its time to arrive; an edge that left more slowly shows its sender
_RELEASED = 2.0  # times its time to arrive: no link and no sender is so uneven
_LEAST_DISPERSION_S = 0.5e-3  # less is the jitter of time stamps


class Arrival(NamedTuple):
    """Arrival of one packet of a train: its size on the link, and time stamps of two different clocks (ns)."""

    wire_bytes: int
    sent_ns: int
    received_ns: int


def measure_train(arrivals: list[Arrival], *, packets: int) -> Train | None:
    """Measure a train along the lower envelope of its arrivals.

    On a link that is never idle, packet i arrives at a + b_i/C, where b_i bytes were sent before it. Every disturbance
    makes a time stamp later, never earlier: the receiving thread wakes up late, a radio delivers an aggregate at once,
    another message comes in between. So the true line touches the points (b_i, t_i) from below, and a stretch of it is
    on their lower convex hull: the edge that spans most bytes. A late first stamp, or a bucket of saved-up tokens,
    bends only the beginning of the hull; of an aggregate the hull keeps the last packet. Measured over a token bucket
    at 20 Mbit/s: from first to last arrival trains read up to 38 % too high, along their longest edge up to 1 %.

    Where no edge spans enough packets (the train is short, and jitter bends it), the whole hull counts, from its first
    point to its last. An edge that arrived as slowly as it left shows the sender and does not count; a train without
    another edge counts as a whole, and its ``sent_s`` shows that this is the sender's rate.

    Dispersion of trains: Dovrolis, Ramanathan and Moore, "Packet-Dispersion Techniques and a Capacity-Estimation
    Methodology", IEEE/ACM Trans. Networking 12(6), 2004. Aggregates at the receiver: Prasad, Jain and Dovrolis,
    "Effects of Interrupt Coalescence on Network Measurements", PAM 2004. Convex hulls of delays: Moon, Skelly and
    Towsley, "Estimation and Removal of Clock Skew from Network Delay Measurements", INFOCOM 1999.

    Parameters
    ----------
    arrivals : packets of the train, in order of arrival
    packets : number of packets sent

    Returns
    -------
    The train: bytes, packets and both spans after the first point of the edge. None when more than a tenth was lost,
    when a clock stepped back meanwhile, or when all arrived at once, so nothing was dispersed.
    """
    if len(arrivals) < max(2.0, (1.0 - _MOST_LOST) * packets):
        return None
    if min(late.received_ns - early.received_ns for early, late in pairwise(arrivals)) < 0:
        return None
    carried = list(accumulate(arrival.wire_bytes for arrival in arrivals))
    hull: list[int] = []
    for index in range(len(arrivals)):
        while len(hull) > 1 and _is_above(arrivals, carried, hull[-2], hull[-1], index):
            hull.pop()
        hull.append(index)
    # The level part of the hull is a group that arrived together; it ends where time begins to pass.
    start = max(index for index in hull if arrivals[index].received_ns == arrivals[0].received_ns)
    hull = [index for index in hull if index >= start]
    edges = [_train_between(arrivals, carried, early, late) for early, late in pairwise(hull)]
    least = max(2, min(_LEAST_EDGE, (len(arrivals) - 1) // 2))
    most = max(
        (edge for edge in edges if edge.packets >= least and edge.sent_s < _SENT_AS_SLOWLY * edge.duration_s),
        key=lambda edge: edge.payload_bytes,
        default=None,
    )
    if most is None:
        # An edge that arrived much faster than it left is also a group, stamped at the receiver's own pace.
        spread = [early for early, edge in zip(hull, edges, strict=False) if edge.sent_s < _RELEASED * edge.duration_s]
        most = _train_between(arrivals, carried, spread[0], hull[-1]) if spread else None
    return most if most is not None and most.duration_s > _LEAST_DISPERSION_S else None


def _train_between(arrivals: list[Arrival], carried: list[int], early: int, late: int) -> Train:
    return Train(
        payload_bytes=carried[late] - carried[early],
        duration_s=(arrivals[late].received_ns - arrivals[early].received_ns) / 1e9,
        packets=late - early,
        sent_s=max(0.0, (arrivals[late].sent_ns - arrivals[early].sent_ns) / 1e9),
    )


def _is_above(arrivals: list[Arrival], carried: list[int], early: int, middle: int, late: int) -> bool:
    """Return whether the middle one of three points is on or above the line between the others."""
    rise = arrivals[middle].received_ns - arrivals[early].received_ns
    whole_rise = arrivals[late].received_ns - arrivals[early].received_ns
    return rise * (carried[late] - carried[early]) >= whole_rise * (carried[middle] - carried[early])


class Receiver:
    """Collects probe arrivals between two reports, and makes the reports.

    Probes do not overtake each other on the link: a train is complete when its last packet arrives, or when a later
    probe shows that the last packet is lost. Reports cost as much as pings, on the way back. So pings set their pace:
    fewer pings, fewer reports.

    Parameters
    ----------
    peer : name in the reports
    begin_s : of the first interval (s)
    counted : bytes and packets that the interface had received by then, None = unknown

    Attributes
    ----------
    due_s : when to `look` at the latest (s)
    """

    def __init__(self, peer: str, begin_s: float, counted: tuple[int, int] | None = None) -> None:
        self._peer, self._sent_s, self._counted = peer, begin_s, counted
        self._quiet_s = self._wait_s = QUIET_S
        self._late_s = BUSY_S  # after a report, when the next ping is late
        self.due_s = begin_s + QUIET_S
        self._delays_s: list[float] = []
        self._trains: list[Train] = []
        self._last_probe = self._packets_before = 0  # arrived packets of the probes before the last one
        self._received = 0  # packets of all probes
        self._number, self._packets = -1, 0  # train whose packets arrive now
        self._arrivals: list[Arrival] = []

    def on_probe(self, probe: ProbeHeader, payload_bytes: int, *, sent_ns: int, received_ns: int) -> None:
        """Note one probe packet with the timestamps of its MessageInfo (ns, two different clocks)."""
        self._quiet_s = min(LONGEST_QUIET_S, max(QUIET_S, probe.quiet_s))
        self._late_s = min(LONGEST_QUIET_S, max(BUSY_S, probe.quiet_s))
        # A ping's delay is the first sign of a queue, and a train of a rise, so no report waits for further probes.
        if probe.index == probe.packets - 1:
            self._wait_s = PROMPT_S
            self.due_s = min(self.due_s, self._sent_s + PROMPT_S)
        if probe.index == 0:
            del self._delays_s[:-_MOST_KEPT]
            self._delays_s.append((received_ns - sent_ns) / 1e9)
            self._last_probe, self._packets_before = probe.train, self._received
        self._received += 1
        if probe.packets == 1:
            if len(self._arrivals) >= (1.0 - _MOST_LOST) * self._packets:
                self._close()
            return
        if probe.train != self._number:
            self._close()
            self._number, self._packets = probe.train, probe.packets
        if len(self._arrivals) >= self._packets:
            return  # the train is closed, or a sender repeats packets
        self._arrivals.append(Arrival(probe_wire_bytes(payload_bytes), sent_ns, received_ns))
        if probe.index == probe.packets - 1:
            self._close()

    def look(self, now_s: float, counted: tuple[int, int] | None) -> PeerReport | None:
        """Return the report that leaves now, None before it is due.

        Parameters
        ----------
        counted : bytes and packets that the interface has received so far; None = it is gone
        """
        after = counted or self._counted
        before = self._counted or after
        rx_bytes, rx_packets = (after[0] - before[0], after[1] - before[1]) if after and before else (0, 0)
        if rx_bytes >= WORTH_BYTES:  # while a queue stands, pings are late
            self._wait_s = min(self._wait_s, self._late_s)
        if now_s < (due_s := self._sent_s + self._wait_s):
            self.due_s = due_s
            return None
        report = PeerReport(
            peer=self._peer,
            received_at_s=now_s,
            interval_s=min(now_s - self._sent_s, _LONGEST_S),
            rx_bytes=rx_bytes,
            rx_packets=rx_packets,
            delays_s=tuple(self._delays_s),
            trains=tuple(self._trains),
            last_probe=self._last_probe,
            probe_packets=self._packets_before,
        )
        self._delays_s, self._trains = [], []
        self._sent_s, self._counted, self._wait_s, self.due_s = now_s, after, self._quiet_s, now_s + self._late_s
        return report

    def _close(self) -> None:
        if self._arrivals and (measured := measure_train(self._arrivals, packets=self._packets)) is not None:
            del self._trains[:-_MOST_KEPT]
            self._trains.append(measured)
        self._arrivals, self._packets = [], 0
