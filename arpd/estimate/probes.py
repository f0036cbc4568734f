"""Schedule of the probes, within a small share of the capacity, and their loss."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.probing import PeerReport, ProbeRequest
from arpd.model.wire import probe_wire_bytes

if TYPE_CHECKING:
    from collections.abc import Iterator

_QUIET_PINGS = 1.2  # periods of the pings; a peer that receives a ping in time sends nothing in between
SHARE = 0.008  # part of the capacity for probes and the reports they cause
SHORT_SHARE = 0.015  # the same while topics ask for more than the link is believed to carry
PINGS_SHARE = 0.0035  # part of it for pings and their reports alone
REPORT_BYTES = 230  # a report on the wire
PING_S, PING_MOST_S = 0.09, 0.55  # least and most time between pings
RESTING_PING_S = 0.3  # least while next to nothing crosses: an outage harms nobody then
PING_BYTES = 16  # payload of a ping
OUTAGE_PING_S, OUTAGE_PING_BYTES = 0.5, 200  # time between pings, and their payload, while the link is out
PACKET_BYTES = 1_200  # payload in a train; with 16 bytes of layout one datagram, `arpd.model.wire.FRAGMENT_BYTES`
TRAIN_S, TRAIN_LEAST_PACKETS, TRAIN_MOST_PACKETS = 0.005, 4, 24  # length of a train in link time, and its bounds
SMALL_TRAIN_PACKETS, SMALL_PACKET_BYTES = 16, 16  # number and payload of the packets of a train of small ones
# One in so many large trains is followed by one of small packets, after this time.
SMALL_EVERY, PAIR_S = 10, 0.15
# Least time between trains: before any measurement, in general, and while the capacity is doubtful.
FIRST_S, CALM_S, DOUBTFUL_S = 0.25, 2.5, 0.5
SHORT_S, SHORT_TRAIN_S = 1.0, 0.09  # the same while more is asked, where a train takes no longer than the latter
RESTING_TRAIN_S = 60.0  # time between trains then
TRAIN_MOST_S = 15.0  # most time between trains at any cost, because only a train shows that a link became better
SAVED_S = 5.0  # span of the budget that can be saved


class ProbeSchedule:
    """Schedules pings for the queue and trains for the capacity; a token bucket of link bytes pays for trains.

    Calm trains spend a part of the budget. The rest is saved for the seconds after a fall, when several trains are
    worth most.
    """

    def __init__(self) -> None:
        self._last_s = self._ping_at_s = self._train_at_s = -math.inf
        self._saved_bytes = 0.0
        self._small_at_s = math.inf
        self._trains = self._probes = 0
        self._quiet_s = 0.0

    def hurry(self) -> None:
        """Let the next ping leave at once."""
        self._ping_at_s = -math.inf

    def repeat_train(self) -> None:
        """Let the next train leave at once; calm ones pay for it."""
        self._train_at_s = -math.inf

    def wanted(
        self,
        now_s: float,
        *,
        capacity: float,
        is_measured: bool,
        is_out: bool,
        is_free: bool,
        is_urgent: bool,
        needs_pair: bool,
        copies: int,
        is_short: bool,
        is_resting: bool = False,
    ) -> Iterator[ProbeRequest]:
        """Yield the probes to send now.

        Parameters
        ----------
        capacity : the one that is believed (bytes/s)
        is_measured : True when it was measured
        is_out, is_free : True while the link is out; True while no queue stands, which a train would only lengthen
        is_urgent : True while the capacity is likely to be wrong
        needs_pair : True while the overhead of a packet is unknown
        copies : times that each probe crosses the link, once per peer
        is_short : True while topics ask for more than the link is believed to carry
        is_resting : True while next to nothing crosses; nobody needs the capacity soon then
        """
        elapsed_s, self._last_s = min(1.0, now_s - self._last_s), now_s
        ping_bytes = copies * probe_wire_bytes(PING_BYTES) + copies * REPORT_BYTES
        ping_s = min(PING_MOST_S, max(PING_S, ping_bytes / (PINGS_SHARE * capacity)))
        ping_s = max(ping_s, RESTING_PING_S) if is_resting else ping_s
        self._quiet_s = _QUIET_PINGS * ping_s
        packets = max(TRAIN_LEAST_PACKETS, min(TRAIN_MOST_PACKETS, math.ceil(TRAIN_S * capacity / PACKET_BYTES)))
        cost = copies * packets * probe_wire_bytes(PACKET_BYTES)
        is_short = is_short and cost <= SHORT_TRAIN_S * capacity
        budget = max(0.1 * SHARE * capacity, SHARE * capacity - ping_bytes / ping_s)
        # Savings of a better link stay: right after a fall they pay for the trains that see the link return.
        room = max(2.0 * cost, SAVED_S * budget, self._saved_bytes)
        more = (SHORT_SHARE - SHARE) * capacity if is_short else 0.0
        self._saved_bytes = min(self._saved_bytes + (budget + more) * elapsed_s, room)
        if now_s >= self._ping_at_s:
            self._ping_at_s = now_s + (OUTAGE_PING_S if is_out else ping_s)
            yield self._request(1, OUTAGE_PING_BYTES if is_out else PING_BYTES)
        if is_out or not is_free:
            return
        can_pay = self._saved_bytes >= cost
        if not is_measured:
            pause_s = FIRST_S
        elif is_urgent and can_pay:
            pause_s = DOUBTFUL_S
        elif is_resting or not can_pay:
            pause_s = RESTING_TRAIN_S if is_resting else TRAIN_MOST_S
        else:
            pause_s = max(SHORT_S, cost / (budget + more)) if is_short else CALM_S
        if now_s >= self._small_at_s:
            self._small_at_s = math.inf
            self._spend(copies * SMALL_TRAIN_PACKETS * probe_wire_bytes(SMALL_PACKET_BYTES), is_measured=is_measured)
            yield self._request(SMALL_TRAIN_PACKETS, SMALL_PACKET_BYTES)
        elif now_s - self._train_at_s >= pause_s:
            self._train_at_s = now_s
            self._spend(cost, is_measured=is_measured)
            self._trains += 1
            if needs_pair or self._trains % SMALL_EVERY == 0:
                self._small_at_s = now_s + PAIR_S
            yield self._request(packets, PACKET_BYTES)

    def _spend(self, cost: float, *, is_measured: bool) -> None:
        # The first trains may exceed the budget, and this debt is not paid back.
        self._saved_bytes = self._saved_bytes - cost if is_measured else max(0.0, self._saved_bytes - cost)

    def _request(self, packets: int, packet_bytes: int) -> ProbeRequest:
        self._probes += 1
        return ProbeRequest(packets=packets, packet_bytes=packet_bytes, number=self._probes, quiet_s=self._quiet_s)


_WINDOW_S = 20.0  # 250 packets on a fast link, 50 on a slow one
_LEAST_PACKETS = 20  # fewer show nothing
_MOST_SENT = 1000  # probes remembered: a minute and more
_OVERTAKING = 32  # packets that may arrive late or twice; more means that the peer restarted
_COUNTS = 2**32  # on the wire


class ProbeLoss:
    """Share of recent probe packets that never reached a peer.

    A peer counts the packets of all probes before the last one whose first packet it has. Probes do not overtake each
    other on the link, so the missing ones of those are lost; packets on their way belong to later probes. Counts are
    cumulative, so lost reports do not matter.
    """

    def __init__(self) -> None:
        self._sent = 0  # packets so far
        self._sent_before: dict[int, int] = {}  # packets of all earlier probes, by number of the probe
        self._marks: dict[str, deque[tuple[float, int, int]]] = {}  # time s, packets sent, packets it has; by peer

    def note_sent(self, request: ProbeRequest) -> None:
        """Note a probe that leaves."""
        self._sent_before[request.number] = self._sent
        self._sent += request.packets
        while len(self._sent_before) > _MOST_SENT:
            del self._sent_before[next(iter(self._sent_before))]

    def digest(self, report: PeerReport) -> None:
        """Note the count of a report."""
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
                return  # nothing new, or a later report came first
        marks.append((report.received_at_s, sent, report.probe_packets))

    def ratio(self, now_s: float) -> float | None:
        """Return the lost share over all peers; None when too few packets were sent."""
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
