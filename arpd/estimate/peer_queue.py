"""Queue in front of the link, as the reports of peers show it."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from arpd.estimate import parameters
from arpd.estimate.local_queue import Look, StandingQueue
from arpd.estimate.receiver import PROMPT_S

if TYPE_CHECKING:
    from arpd.model.probing import PeerReport

_BYTES_ARE_FRESH_S = 0.3
_MISSING_PINGS = 5
_MOST_MISSING = 0.25  # pings are reported up to `PROMPT_S` late, a fifth of their period
# What waits is read at a tick, up to 20 ms after the report left. So the bytes that arrive in a shorter interval may
# have come meanwhile, to a link that was idle.
_LEAST_INTERVAL_S = 0.05
_HELD_INTERVAL_S = 1.5 * PROMPT_S  # a shorter report had to wait before it left


class SentPing(NamedTuple):
    """Ping that left: its number, its departure (s), and the bytes handed to the interface before; None = unknown."""

    number: int
    sent_s: float
    handed_bytes: float | None


class _Recent:
    """Times of the last 10 s, of any clock, of which only the least counts; infinite before any (s).

    Longer silence does not age them: in an outage a queue stands, and no ping shows what the way takes without one.
    """

    def __init__(self) -> None:
        self._noted: deque[tuple[float, float]] = deque()  # (age of this, time), both ascending
        self._at_s, self._age_s = math.inf, 0.0

    def note(self, now_s: float, value_s: float) -> float:
        """Note one, and return its excess over the least (s)."""
        self._age_s += max(0.0, min(now_s - self._at_s, parameters.OUTAGE_FORGET_S))
        self._at_s = now_s
        while self._noted and self._noted[-1][1] >= value_s:
            self._noted.pop()
        self._noted.append((self._age_s, value_s))
        while self._age_s - self._noted[0][0] > parameters.DELAY_WINDOW_S:
            self._noted.popleft()
        return value_s - self.least_s

    @property
    def least_s(self) -> float:
        return self._noted[0][1] if self._noted else math.inf


class QueueGauge:
    """Three witnesses of the queue between this host and one peer; none needs synchronised clocks.

    - *Delay*: the one-way delay of a ping above its least of the last 10 s. Exact, and late by the queue itself.
    - *Overdue*: a ping is on its way for longer than the least round trip. The queue is at least that long.
    - *Bytes*: the bytes handed to the interface since the departure of the last ping that arrived, less the bytes that
      the peer received since its arrival. In a FIFO that is exactly the queue, half a second before a ping can show it.
      Lost bytes look the same until the next ping arrives, so bytes may only raise an alarm.

    The way back has one witness: the one-way delay of a report above its least of the last 10 s. Commands wait as long.

    Parameters
    ----------
    reported_s : last report of the peer, whose other measurements are forgotten (s)
    """

    def __init__(self, reported_s: float = -math.inf) -> None:
        self.reported_s = reported_s
        self.delay_s = 0.0
        self.return_delay_s: float | None = None
        self.backlog = StandingQueue(fresh_s=_BYTES_ARE_FRESH_S, least_span_s=_LEAST_INTERVAL_S)
        self._delays, self._return_delays, self._round_trips = _Recent(), _Recent(), _Recent()
        self._deliveries: deque[tuple[float, float, int, int]] = deque()  # arrival s, interval s, bytes, packets
        self._under_way: deque[SentPing] = deque(maxlen=100)  # trains are not: their reports wait for further probes
        self._since_ping: tuple[float, float] | None = None  # bytes handed before it, received after it
        self._last_ping: SentPing | None = None
        # Bytes on the way when pings that met no queue arrived, and the rate of arrivals then.
        self._in_flight: deque[tuple[float, float]] = deque(maxlen=_MISSING_PINGS)
        self._missing: deque[float] = deque(maxlen=_MISSING_PINGS)  # as parts of the bytes handed over

    def note_sent(self, ping: SentPing) -> None:
        """Note a ping that leaves."""
        self._under_way.append(ping)

    def digest(self, report: PeerReport, *, handed_bytes: float | None) -> None:
        """Note a report, and the bytes handed to this host's interface by now; None = unknown."""
        before_s, now_s = self.reported_s, report.received_at_s
        self.reported_s = now_s
        self._deliveries.append((now_s, report.interval_s, report.rx_bytes, report.rx_packets))
        window_s = parameters.DELIVERY_WINDOW_S - report.interval_s / 2
        while len(self._deliveries) > 1 and now_s - self._deliveries[0][0] > window_s:
            self._deliveries.popleft()
        if self._since_ping is not None:
            self._since_ping = self._since_ping[0], self._since_ping[1] + report.rx_bytes
        self.backlog.busy_rate = None
        round_trip_s = self._arrived(report)
        # A delay that no ping of ours explains says nothing: it may come from a second peer of the same name.
        if report.delays_s and round_trip_s < math.inf:
            # Round trips use our own clock, so they bound what a step of the peer's clock adds to a delay. The least
            # round trip may include a wait for its report that is `PROMPT_S` longer than this one.
            most_s = round_trip_s - self._round_trips.least_s + PROMPT_S
            # The least of a report counts: a late wakeup of the receiver only adds delay.
            self.delay_s = min(self._delays.note(now_s, min(report.delays_s)), most_s)
            if report.return_delay_s is not None:
                self.return_delay_s = min(self._return_delays.note(now_s, report.return_delay_s), most_s)
        if self._missing and median(self._missing) > _MOST_MISSING:
            self.backlog.clear()  # much of what this host sends goes elsewhere or is lost, so the queue is unknown
        elif handed_bytes is not None and self._since_ping is not None:
            outstanding = handed_bytes - self._since_ping[0] - self._since_ping[1]
            self._note_outstanding(report, outstanding, silent_s=now_s - before_s)

    def _note_outstanding(self, report: PeerReport, outstanding: float, *, silent_s: float) -> None:
        rate = report.rx_bytes / report.interval_s if report.interval_s > 0 else 0.0
        if report.delays_s and self.delay_s < parameters.QUEUE_LOW_S:
            self._in_flight.append((outstanding, max(1.0, rate)))
        # Some bytes are on the way even without a queue, fewer on a slower link, and some arrivals since the ping are
        # not counted yet.
        on_way = min(
            (min(size, max(parameters.BURST_BYTES, size * rate / then)) for size, then in self._in_flight), default=0.0
        )
        # While the report waited on its way back, more was handed over, and as much arrived.
        late = 1.5 * max(0.0, self.return_delay_s or 0.0) * rate
        backlog, now_s = outstanding - max(0.0, on_way) - late, report.received_at_s
        look = Look(now_s, backlog, report.rx_bytes, is_late=not report.delays_s)
        self.backlog.note(look, interval_s=report.interval_s)
        # What is on a long way looks like what waits, and so do lost bytes; but a ping arrives after what it waits for.
        has_left = self._last_ping is not None and now_s - self._last_ping.sent_s < silent_s
        if has_left or report.interval_s < self._round_trips.least_s < math.inf:
            self.backlog.busy_rate = None

    def _arrived(self, report: PeerReport) -> float:
        """Settle every ping up to the probe of a report, and return the round trip of the last ping (s)."""
        round_trip_s, now_s = math.inf, report.received_at_s
        while self._under_way and self._under_way[0].number <= report.last_probe:
            ping = self._under_way.popleft()
            round_trip_s = now_s - ping.sent_s
            self._round_trips.note(now_s, round_trip_s)
            if ping.number != report.last_probe:
                continue
            self._last_ping = ping
            if ping.handed_bytes is None:
                self._since_ping = None
                continue
            if self._since_ping is not None:
                # What left between two pings and did not arrive between them: in a FIFO, that is no queue.
                handed, received = self._since_ping
                if (sent := ping.handed_bytes - handed) > parameters.BURST_BYTES:
                    self._missing.append(1.0 - received / sent)
            # At worst, all bytes of a report that was held arrived after its ping.
            later = float(report.rx_bytes) if report.interval_s < _HELD_INTERVAL_S else 0.0
            self._since_ping = ping.handed_bytes, later
        return round_trip_s

    def queue_s(self, now_s: float, *, handed_bytes: float | None, capacity: float) -> float:
        """Return the queue now: the one that the last ping met, what came since, less what the link carried (s).

        A queue delays the pings that measure it, so a missing ping is the earliest evidence: the queue is at least as
        long as the oldest one is overdue.
        """
        ping, queue_s = self._last_ping, self.delay_s
        if ping is not None and ping.handed_bytes is not None and handed_bytes is not None:
            come_s = max(0.0, handed_bytes - ping.handed_bytes) / capacity
            queue_s = max(0.0, self.delay_s + come_s - (now_s - ping.sent_s))
        if not self._under_way:
            return queue_s
        # The usual round trip grows with a queue that stands, and would hide it. A report may wait, too.
        without_s = self._round_trips.least_s + PROMPT_S + (self.return_delay_s or 0.0)
        return max(queue_s, now_s - self._under_way[0].sent_s - without_s)

    def delivery(self, since_s: float) -> tuple[float, float]:
        """Return what the peer received in the last intervals that began since then (bytes/s, packets/s)."""
        counted = [each for each in self._deliveries if each[0] - each[1] >= since_s]
        covered_s = sum(interval_s for _, interval_s, _, _ in counted)
        if covered_s <= 0:
            return 0.0, 0.0
        return sum(size for _, _, size, _ in counted) / covered_s, sum(packets for *_, packets in counted) / covered_s


class PeerGauges:
    """Gauges of all peers: what they receive adds up, and the longest queue counts."""

    def __init__(self) -> None:
        self._gauges: dict[str, QueueGauge] = {}  # by name, the one heard for longest first

    def __len__(self) -> int:
        return len(self._gauges)

    def digest(self, report: PeerReport, *, handed_bytes: float | None) -> QueueGauge:
        """Note a report, forget silent peers, and return the gauge of the peer; see `QueueGauge.digest`."""
        self._gauges = {
            name: gauge
            for name, gauge in self._gauges.items()
            if report.received_at_s - gauge.reported_s <= parameters.OUTAGE_FORGET_S or name == report.peer
        }
        gauge = self._gauges.setdefault(report.peer, QueueGauge())
        # With several peers, bytes that one did not receive may be another's.
        gauge.digest(report, handed_bytes=handed_bytes if len(self._gauges) == 1 else None)
        return gauge

    def is_first(self, name: str) -> bool:
        """Return whether no other peer has been heard for longer."""
        return next(iter(self._gauges), "") == name

    def note_sent(self, ping: SentPing) -> None:
        """Note a ping that leaves; it crosses the link once per peer."""
        for gauge in self._gauges.values():
            gauge.note_sent(ping)

    def forget(self) -> None:
        """Forget all measurements of every peer: they describe another link, or another queue."""
        self._gauges = {name: QueueGauge(gauge.reported_s) for name, gauge in self._gauges.items()}

    def delay_s(self, now_s: float, *, handed_bytes: float | None, capacity: float) -> float:
        """Return the longest queue now by the pings, also by one that has not arrived yet (s).

        While another peer reports, one that is silent is gone, and no queue holds its pings.
        """
        newest_s = max((gauge.reported_s for gauge in self._gauges.values()), default=-math.inf)
        heard = (each for each in self._gauges.values() if newest_s - each.reported_s <= parameters.OUTAGE_S)
        return max((each.queue_s(now_s, handed_bytes=handed_bytes, capacity=capacity) for each in heard), default=0.0)

    @property
    def busy_rate(self) -> float | None:
        """Capacity over the last report of the only peer, None where the link may have idled (bytes/s)."""
        return next(iter(self._gauges.values())).backlog.busy_rate if len(self) == 1 else None

    def backlog_s(self, now_s: float, *, burst_bytes: float, capacity: float) -> float:
        """Return how long the missing bytes of the longest queue will take to arrive (s)."""
        backlogs = (gauge.backlog for gauge in self._gauges.values())
        return max((each.delay_s(now_s, burst_bytes=burst_bytes, capacity=capacity) for each in backlogs), default=0.0)

    def delivery(self, since_s: float = -math.inf) -> tuple[float, float]:
        """Return what all peers received in the last intervals that began since then (bytes/s, packets/s)."""
        each = [gauge.delivery(since_s) for gauge in self._gauges.values()]
        return sum(size for size, _ in each), sum(packets for _, packets in each)

    def overhead_of(self, rate: float, packet_overhead_s: float) -> float:
        """Return the part of the time that packets of the recent size cost beyond their bytes at a rate (bytes/s)."""
        received, packet_rate = self.delivery()
        return rate * packet_rate / received * packet_overhead_s if received > 0 else 0.0

    @property
    def return_delay_s(self) -> float | None:
        """Delay of a report by the longest queue on the way back; None while unknown (s)."""
        return max((d for gauge in self._gauges.values() if (d := gauge.return_delay_s) is not None), default=None)
