"""When to probe the link, and with how much, within one per cent of what it carries."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.probing import PeerReport, ProbeRequest
from arpd.model.wire import probe_wire_bytes

if TYPE_CHECKING:
    from collections.abc import Iterator

_QUIET_PINGS = 1.2  # a peer that hears a ping in time says nothing in between


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeParameters:
    """How probing divides its share of the link.

    Parameters
    ----------
    share : of the capacity, for probes and the reports they provoke
    pings_share : of the capacity, for pings and their reports alone
    report_bytes : a report on the wire (bytes)
    ping_s, ping_most_s : least and most time between pings (s)
    ping_bytes : payload of a ping (bytes)
    outage_ping_s, outage_ping_bytes : the same while the link is out
    packet_bytes, small_packet_bytes : payload of a train's packets, and of those of a train of small ones (bytes)
    train_s, train_least_packets, train_most_packets : length of a train in link time (s), and its bounds
    small_packets : packets of a train of small ones
    calm_s, urgent_s, confirm_s : least time between trains, while the belief is doubtful, and after a train that
        contradicts it (s)
    first_s : the same before there is any belief (s)
    train_most_s : most time between trains, whatever they cost: who never looks never learns that a link is better (s)
    saved_s : unspent budget is kept for so long (s)
    small_every : one in so many large trains is followed by one of small packets
    pair_s : so soon after it (s)
    """

    share: float = 0.0095
    pings_share: float = 0.0035
    report_bytes: int = 230
    ping_s: float = 0.09
    ping_most_s: float = 0.55
    ping_bytes: int = 16
    outage_ping_s: float = 0.5
    outage_ping_bytes: int = 200
    packet_bytes: int = (
        1_200  # with its 16 bytes of layout just a datagram of its own, `arpd.model.wire.FRAGMENT_BYTES`
    )
    small_packet_bytes: int = 16
    train_s: float = 0.005
    train_least_packets: int = 4
    train_most_packets: int = 24
    small_packets: int = 16
    calm_s: float = 2.5
    urgent_s: float = 0.5
    confirm_s: float = 0.08
    first_s: float = 0.25
    train_most_s: float = 15.0
    saved_s: float = 5.0
    small_every: int = 10
    pair_s: float = 0.15


class ProbeSchedule:
    """Pings for the queue, trains for the capacity; trains live on a token bucket of link bytes.

    Calm trains spend a part of the budget. The rest is saved for the moments after a fall or a surprise, when several
    of them within a few seconds are worth most.

    Parameters
    ----------
    parameters : the budget and its division
    """

    def __init__(self, parameters: ProbeParameters | None = None) -> None:
        self._parameters = parameters or ProbeParameters()
        self._last_s = -math.inf
        self._saved_bytes = 0.0
        self._ping_at_s = -math.inf
        self._train_at_s = -math.inf
        self._small_at_s = math.inf
        self._trains = 0
        self._is_confirming = False
        self._probes = 0
        self.quiet_s = 0.0

    def wanted(
        self,
        now_s: float,
        *,
        capacity_bytes_per_second: float,
        is_measured: bool,
        is_out: bool,
        is_free: bool,
        is_urgent: bool,
        surprise_bytes_per_second: float | None,
        needs_pair: bool,
        copies: int,
    ) -> Iterator[ProbeRequest]:
        """Yield what is to be sent now.

        Parameters
        ----------
        capacity_bytes_per_second : what is believed of the link
        is_measured : whether that was measured
        is_out, is_free : whether the link is out; whether no queue stands, which a train would only lengthen
        is_urgent : whether the belief is likely to be wrong
        surprise_bytes_per_second : what the last train saw, if that contradicts the belief
        needs_pair : whether the overhead of a packet is not known yet
        copies : times each probe crosses the link: one for each peer
        """
        t = self._parameters
        elapsed_s, self._last_s = min(1.0, now_s - self._last_s), now_s
        ping_bytes = copies * probe_wire_bytes(t.ping_bytes) + copies * t.report_bytes
        ping_s = min(t.ping_most_s, max(t.ping_s, ping_bytes / (t.pings_share * capacity_bytes_per_second)))
        self.quiet_s = _QUIET_PINGS * ping_s
        budget = (
            max(0.1 * t.share, t.share - ping_bytes / ping_s / capacity_bytes_per_second) * capacity_bytes_per_second
        )
        is_surprised = surprise_bytes_per_second is not None
        # A train that is to confirm another is long enough for what that one saw.
        expected = max(capacity_bytes_per_second, surprise_bytes_per_second or 0.0)
        packets = math.ceil(t.train_s * expected / t.packet_bytes)
        packets = max(t.train_least_packets, min(t.train_most_packets, packets))
        cost = copies * packets * probe_wire_bytes(t.packet_bytes)
        # What was saved on a better link stays: right after a fall it buys the trains that see the link return.
        room = max(2.0 * cost, t.saved_s * budget, self._saved_bytes)
        self._saved_bytes = min(self._saved_bytes + budget * elapsed_s, room)
        if now_s >= self._ping_at_s:
            self._ping_at_s = now_s + (t.outage_ping_s if is_out else ping_s)
            yield self._request(1, t.outage_ping_bytes if is_out else t.ping_bytes)
        if is_out or not is_free:
            return
        if now_s >= self._small_at_s:
            self._small_at_s = math.inf
            self._spend(copies * t.small_packets * probe_wire_bytes(t.small_packet_bytes), is_measured=is_measured)
            yield self._request(t.small_packets, t.small_packet_bytes)
        elif now_s - self._train_at_s >= self._pause_s(
            cost, is_measured=is_measured, is_urgent=is_urgent, is_surprised=is_surprised
        ):
            self._train_at_s = now_s
            self._is_confirming = is_surprised  # one surprise is confirmed on credit
            self._spend(cost, is_measured=is_measured)
            self._trains += 1
            if needs_pair or self._trains % t.small_every == 0:
                self._small_at_s = now_s + t.pair_s
            yield self._request(packets, t.packet_bytes)

    def _spend(self, cost: float, *, is_measured: bool) -> None:
        # What the first trains cost beyond the budget is the price of knowing anything, and not paid back.
        self._saved_bytes = self._saved_bytes - cost if is_measured else max(0.0, self._saved_bytes - cost)

    def _pause_s(self, cost: float, *, is_measured: bool, is_urgent: bool, is_surprised: bool) -> float:
        """Return how long to wait between two trains (s)."""
        t = self._parameters
        if not is_measured:
            return t.first_s
        can_pay = self._saved_bytes >= cost
        if is_surprised and (can_pay or not self._is_confirming):
            return t.confirm_s
        if is_urgent and can_pay:
            return t.urgent_s
        return t.calm_s if can_pay else t.train_most_s

    def _request(self, packets: int, packet_bytes: int) -> ProbeRequest:
        self._probes += 1
        return ProbeRequest(packets=packets, packet_bytes=packet_bytes, number=self._probes, quiet_s=self.quiet_s)


_WINDOW_S = 20.0  # 250 packets on a fast link, 50 on a slow one
_LEAST_PACKETS = 20  # fewer tell nothing
_MOST_SENT = 1000  # probes remembered: a minute and more
_OVERTAKING = 32  # packets that may come after the first of a later probe, or twice; more is a peer that started anew
_COUNTS = 2**32  # on the wire


class ProbeLoss:
    """Share of the probe packets of the last seconds that never reached a peer.

    A peer counts the packets of all probes before the last one whose first packet it has. As probes overtake nobody on
    the link, what it lacks of those is lost; what is under way belongs to the last one or to later ones. Counts go on
    and on, so that reports may be lost.
    """

    def __init__(self) -> None:
        self._sent = 0  # packets so far
        self._sent_before: dict[int, int] = {}  # by number of the probe: packets of all before it
        self._marks: dict[str, deque[tuple[float, int, int]]] = {}  # by peer: when s, packets sent, packets it has

    def note_sent(self, request: ProbeRequest) -> None:
        """Note a probe that leaves."""
        self._sent_before[request.number] = self._sent
        self._sent += request.packets
        while len(self._sent_before) > _MOST_SENT:
            del self._sent_before[next(iter(self._sent_before))]

    def digest(self, report: PeerReport) -> None:
        """Note what a report counts; one of a peer that does not count says nothing."""
        sent = self._sent_before.get(report.last_probe)
        if sent is None or report.probe_packets is None:
            return
        marks = self._marks.setdefault(report.peer, deque())
        if marks:
            _, sent_then, received_then = marks[-1]
            received = (report.probe_packets - received_then) % _COUNTS
            if received > sent - sent_then + _OVERTAKING:
                marks.clear()
            elif sent <= sent_then:
                return  # nothing new, or overtaken by a later report
        marks.append((report.received_at_s, sent, report.probe_packets))

    def ratio(self, now_s: float) -> float | None:
        """Return the share that was lost, of all peers together; None when too few packets were sent to tell."""
        sent = received = 0
        for peer, marks in tuple(self._marks.items()):
            while marks and now_s - marks[0][0] > _WINDOW_S:
                marks.popleft()
            if not marks:
                del self._marks[peer]
                continue
            sent += marks[-1][1] - marks[0][1]
            received += (marks[-1][2] - marks[0][2]) % _COUNTS
        return max(0.0, 1.0 - received / sent) if sent >= _LEAST_PACKETS else None
