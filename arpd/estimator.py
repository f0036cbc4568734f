"""Rmax's other half: the capacity of the link, from receiver reports, probe trains and one-way delay (DESIGN §5)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from arpd.foreign import ForeignTraffic
from arpd.model import CapacityKind, LinkEstimate, LinkState
from arpd.probing import ProbeRequest
from arpd.wire import wire_size

if TYPE_CHECKING:
    from arpd.model import Observation
    from arpd.probing import PeerReport
    from arpd.settings import LinkSettings


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorTuning:
    """Constants of the rules; from a simulation study (DESIGN §5), to be beaten on the real link."""

    queue_high_s: float = 0.100
    queue_low_s: float = 0.050
    burst_cap_s: float = 0.200  # of the allowance for the largest message
    delivery_window_s: float = 0.300
    delay_window_s: float = 10.0
    down_interval_s: float = 0.250
    down_margin: float = 0.95
    undo_window_s: float = 4.0
    undo_ratio: float = 0.85
    undo_to: float = 0.9
    train_window_s: float = 4.0
    train_memory_s: float = 30.0
    up_after_down_s: float = 1.0
    climb_per_second: float = 0.5  # 0.25 in the study; trains that agree let the real link be followed faster
    outage_s: float = 0.4
    outage_forget_s: float = 1.0  # a shorter silence changes nothing of what was known
    peer_lost_s: float = 10.0
    resume_ratio: float = 0.6
    train_bytes: int = 12_000
    train_s: float = 0.015
    train_share: float = 0.01  # of the capacity
    train_packet_bytes: int = 1_300
    surprise_ratio: float = 0.25  # a train that differs this much is confirmed soon
    surprise_interval_s: float = 0.5
    first_interval_s: float = 0.25
    first_wait_s: float = 3.0
    ping_interval_s: float = 0.1
    ping_bytes: int = 16
    outage_ping_interval_s: float = 0.5
    outage_ping_bytes: int = 200


class Estimator:
    """Estimates the link's capacity; one `update` per tick.

    Throughput alone never shows capacity, so it is believed only while a queue stands (rule *down*). Otherwise the
    dispersion of probe trains speaks (rules *train*, *up*, *undo*). Silence is an outage, not a capacity.

    The capacity is that of the whole link: what the peer receives while a queue stands includes foreign traffic, and a
    train, sent faster than the link, leaves others little room between its packets. So foreign traffic is subtracted
    from it. Twice for a moment where that reasoning fails: for traffic to another host than the peer, until trains
    correct the capacity; and for what a train lets in between. The bound on what is yielded bounds that, too.

    Parameters
    ----------
    settings : pin, first belief
    tuning : the constants
    """

    def __init__(self, settings: LinkSettings, tuning: EstimatorTuning | None = None) -> None:
        self._settings = settings
        self._tuning = tuning or EstimatorTuning()
        self._capacity = settings.initial_capacity_bytes_per_second
        self._before_down: float | None = None
        self._down_at_s = -math.inf
        self._changed_at_s = -math.inf
        self._evidence = "no evidence yet"
        self._kind = CapacityKind.CONFIGURED
        self._state = LinkState.APP_LIMITED
        self._started_at_s: float | None = None
        self._last_s = -math.inf
        self._report_at_s = -math.inf
        self._peer = ""
        self._first_wait_s = self._tuning.first_wait_s
        self._delays: deque[tuple[float, float]] = deque()
        self._deliveries: deque[tuple[float, float, int]] = deque()  # arrival s, interval s, bytes
        self._trains: deque[tuple[float, float]] = deque()  # arrival s, bytes/s
        self._queue_delay_s = 0.0
        self._burst_s = 0.0  # link time of the largest message, which is no queue
        self._high_reports = 0
        self._probes = 0
        self._under_way: deque[tuple[int, float]] = deque(maxlen=100)  # probes nobody has reported: number, sent s
        self._round_trips: deque[tuple[float, float]] = deque()  # when reported s, how long after sending s
        self._next_ping_s = -math.inf
        self._next_train_s = -math.inf
        self._blocked: tuple[float, float, int, int] | None = None  # when, blocked s, tx bytes, tx dropped
        self._foreign = ForeignTraffic()
        self._foreign_rate = 0.0
        self._probed_peers = 1

    @property
    def has_evidence(self) -> bool:
        """Whether the first plan may be made: capacity measured, pinned, or nobody there to measure it with."""
        return (
            self._kind is not CapacityKind.CONFIGURED
            or self._settings.capacity_bytes_per_second is not None
            or (self._started_at_s is not None and self._last_s - self._started_at_s > self._first_wait_s)
        )

    def reconfigure(self, settings: LinkSettings) -> None:
        """Take new settings; what was measured stays."""
        self._settings = settings
        if self._kind is CapacityKind.CONFIGURED:
            self._capacity = settings.initial_capacity_bytes_per_second
        if settings.capacity_bytes_per_second is not None:
            self._forget_queue()

    def update(self, observation: Observation) -> LinkEstimate:
        """Digest one observation and return what is believed now."""
        now_s = observation.now_s
        if self._started_at_s is None:
            self._started_at_s = now_s
        elapsed_s = max(0.0, min(1.0, now_s - self._last_s))
        self._last_s = now_s
        largest_bytes = max((publisher.payload_bytes for publisher in observation.publishers), default=0.0)
        self._burst_s = min(self._tuning.burst_cap_s, wire_size(largest_bytes, rate_hz=math.inf)[0] / self._capacity)
        # A peer that is there but silent may only be behind a bad link: do not plan on the first belief in haste.
        self._first_wait_s = self._tuning.peer_lost_s if observation.peers else self._tuning.first_wait_s
        self._foreign_rate = self._foreign.update(observation)
        self._probed_peers = 1 if observation.peers is None else observation.peers
        for report in observation.reports:
            if self._is_from_our_peer(report):
                self._digest(report)
        silence_s = now_s - self._report_at_s
        if silence_s <= self._tuning.outage_s:
            self._state = self._judge(now_s, elapsed_s)
        elif silence_s <= self._tuning.peer_lost_s and observation.peers != 0:
            self._state = LinkState.OUTAGE
        else:
            self._forget_queue()
            self._state = self._judge_alone(observation, elapsed_s)
        return self._estimate(now_s)

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:
        """Probes to send now: a ping for the delay, a train for the capacity when one is due and affordable."""
        if self._settings.capacity_bytes_per_second is not None:
            return ()
        t = self._tuning
        outage = self._state is LinkState.OUTAGE or not math.isfinite(self._report_at_s)
        probes = []
        if now_s >= self._next_ping_s:
            self._next_ping_s = now_s + (t.outage_ping_interval_s if outage else 0.9 * t.ping_interval_s)
            probes.append(self._request(1, t.outage_ping_bytes if outage else t.ping_bytes, now_s))
        if not outage and now_s >= self._next_train_s and self._queue_delay_s < self._queue_low_s:
            size = max(t.train_bytes, t.train_s * self._capacity)
            packets = 1 + math.ceil(size / t.train_packet_bytes)
            probes.append(self._request(packets, t.train_packet_bytes, now_s))
            self._next_train_s = now_s + self._train_interval_s(size)
        return tuple(probes)

    def _request(self, packets: int, packet_bytes: int, now_s: float) -> ProbeRequest:
        self._probes += 1
        self._under_way.append((self._probes, now_s))
        request = ProbeRequest(packets=packets, packet_bytes=packet_bytes, number=self._probes)
        self._foreign.note_probe(request, now_s, peers=self._probed_peers)
        return request

    # -- evidence

    def _digest(self, report: PeerReport) -> None:
        t, now_s = self._tuning, report.received_at_s
        silent_s = now_s - self._report_at_s
        if t.outage_forget_s < silent_s < math.inf:
            self._resume(now_s, silent_s)
        self._report_at_s = now_s
        self._deliveries.append((now_s, report.interval_s, report.rx_bytes))
        while now_s - self._deliveries[0][0] > t.delivery_window_s - report.interval_s / 2:
            self._deliveries.popleft()
        self._note_delays(report, now_s)
        for train in report.trains:
            if math.isfinite(train.rate_bytes_per_second):
                self._trains.append((now_s, train.rate_bytes_per_second))
        while self._trains and now_s - self._trains[0][0] > t.train_memory_s:
            self._trains.popleft()
        if report.trains and self._is_surprised(self._trains[-1][1]):
            self._next_train_s = min(self._next_train_s, now_s + t.surprise_interval_s)

    def _is_from_our_peer(self, report: PeerReport) -> bool:
        """Listen to one peer at a time: delays of two hosts have two unknown clock offsets, and two links."""
        if report.received_at_s - self._report_at_s > self._tuning.peer_lost_s:
            self._peer = report.peer
        return report.peer == self._peer

    def _forget_queue(self) -> None:
        """Nobody measures the queue any more; its last length must not hold the gate."""
        self._delays.clear()
        self._under_way.clear()
        self._round_trips.clear()
        self._queue_delay_s, self._high_reports = 0.0, 0

    def _note_delays(self, report: PeerReport, now_s: float) -> None:
        round_trip_s = math.inf
        while self._under_way and self._under_way[0][0] <= report.last_probe:
            _, sent_s = self._under_way.popleft()
            round_trip_s = now_s - sent_s
            self._round_trips.append((now_s, round_trip_s))
        while self._round_trips and now_s - self._round_trips[0][0] > self._tuning.delay_window_s:
            self._round_trips.popleft()
        if report.delays_s:
            # The smallest of a report: a late wake-up of the receiver can only add delay.
            delay_s = min(report.delays_s)
            self._delays.append((now_s, delay_s))
            while now_s - self._delays[0][0] > self._tuning.delay_window_s:
                self._delays.popleft()
            # The round trip is on our own clock: what a step of the peer's clock adds to the delay is no queue.
            self._queue_delay_s = min(delay_s - min(delay for _, delay in self._delays), round_trip_s)
            self._high_reports = self._high_reports + 1 if self._queue_delay_s > self._queue_high_s else 0
            if self._high_reports == 1:
                # What was delivered before the queue stood is demand, not capacity.
                self._deliveries = deque([self._deliveries[-1]])

    def _resume(self, now_s: float, silent_s: float) -> None:
        self._forget_queue()
        self._deliveries.clear()
        self._trains.clear()
        self._foreign.note_outage(now_s - silent_s, now_s)
        if self._kind is CapacityKind.PEER:
            self._change(
                self._tuning.resume_ratio * self._capacity, now_s, f"reports resumed after {silent_s:.1f} s of silence"
            )

    def _overdue_s(self, now_s: float) -> float:
        """How much longer than usual the oldest unreported probe is under way: the queue is at least that long.

        A queue delays the very pings that measure it; what has not arrived yet is the earliest evidence there is.
        """
        if not self._under_way or not self._round_trips:
            return 0.0
        usual_s = median(round_trip_s for _, round_trip_s in self._round_trips)
        return max(0.0, now_s - self._under_way[0][1] - usual_s)

    @property
    def _delivery_rate(self) -> float:
        covered_s = sum(interval_s for _, interval_s, _ in self._deliveries)
        return sum(size for *_, size in self._deliveries) / covered_s if covered_s > 0 else 0.0

    def _judge(self, now_s: float, elapsed_s: float) -> LinkState:
        """With a peer that reports: the rules down, undo, first, up and level off."""
        t = self._tuning
        if self._high_reports >= 2:
            return self._queue_stands(now_s)
        if self._queue_delay_s > self._queue_low_s:
            return LinkState.DRAINING if now_s - self._down_at_s < t.undo_window_s else LinkState.CONGESTED
        recent = [rate for at_s, rate in self._trains if now_s - at_s <= t.train_window_s]
        if self._kind is not CapacityKind.PEER:
            if len(recent) >= 3:
                self._kind = CapacityKind.PEER
                self._change(median(recent), now_s, f"first {len(recent)} trains")
            return LinkState.APP_LIMITED
        self._undo(now_s)
        trains = recent if len(recent) >= 3 else [rate for _, rate in list(self._trains)[-3:]]
        if len(trains) >= 3 and now_s - self._down_at_s >= t.up_after_down_s:
            self._follow(trains, now_s, elapsed_s)
        busy = self._delivery_rate > 0.8 * self._settings.headroom * self._capacity
        return LinkState.STEADY if busy else LinkState.APP_LIMITED

    def _queue_stands(self, now_s: float) -> LinkState:
        t = self._tuning
        rate = self._delivery_rate
        if now_s - self._down_at_s >= t.down_interval_s and 0 < rate < t.down_margin * self._capacity:
            if now_s - self._down_at_s > t.undo_window_s:
                self._before_down = self._capacity
            self._kind = CapacityKind.PEER
            self._down_at_s = now_s
            self._change(rate, now_s, f"queue of {self._queue_delay_s * 1e3:.0f} ms at this delivery rate")
            # Trains from before say nothing of the link that is now.
            self._trains.clear()
            return LinkState.DRAINING
        return LinkState.DRAINING if now_s - self._down_at_s < t.undo_window_s else LinkState.CONGESTED

    def _undo(self, now_s: float) -> None:
        t = self._tuning
        if self._before_down is None or now_s - self._down_at_s > t.undo_window_s:
            return
        later = [rate for at_s, rate in self._trains if at_s > self._down_at_s]
        if len(later) >= 2 and median(later) > t.undo_ratio * self._before_down:
            self._change(t.undo_to * self._before_down, now_s, "trains contradict the last fall")
            self._before_down = None

    def _follow(self, trains: list[float], now_s: float, elapsed_s: float) -> None:
        """Move towards what trains see, by a bounded part per second either way.

        A sample that lands inside a train makes it read low, never high: one low train is no evidence of a fall, so
        the estimate follows downwards only what the best of the last three still sees.
        """
        step = self._tuning.climb_per_second * elapsed_s
        middle, best = median(trains), max(trains[-3:])
        if middle > self._capacity:
            self._change(min(middle, self._capacity * (1 + step)), now_s, f"trains see {middle * 8e-6:.1f} Mbit/s")
        elif best < 0.9 * self._capacity:
            self._change(max(best, self._capacity * (1 - step)), now_s, f"trains see {best * 8e-6:.1f} Mbit/s")

    def _judge_alone(self, observation: Observation, elapsed_s: float) -> LinkState:
        """Without a peer: what leaves while the local queue pushes back is the capacity; else nothing is learnt."""
        counters = observation.counters
        if counters is None or not counters.is_up:
            return LinkState.OUTAGE
        now_s = observation.now_s
        blocked_s = sum(publisher.blocked_s for publisher in observation.publishers)
        if self._blocked is None or counters.tx_bytes < self._blocked[2]:
            self._blocked = (now_s, blocked_s, counters.tx_bytes, counters.tx_dropped)
        since_s, blocked_before_s, tx_bytes, tx_dropped = self._blocked
        span_s = now_s - since_s
        if span_s < 1.0:
            return LinkState.APP_LIMITED
        self._blocked = (now_s, blocked_s, counters.tx_bytes, counters.tx_dropped)
        sent = (counters.tx_bytes - tx_bytes) / span_s
        pushes_back = blocked_s - blocked_before_s > 0.2 * span_s or counters.tx_dropped > tx_dropped
        if pushes_back and sent > 0:
            self._kind = CapacityKind.LOCAL
            self._change(min(self._capacity, sent), now_s, "local queue pushed back at this send rate")
            return LinkState.CONGESTED
        if self._kind is not CapacityKind.CONFIGURED:
            self._kind = CapacityKind.LOCAL
            ceiling = max(self._settings.initial_capacity_bytes_per_second, self._capacity)
            grown = self._capacity * (1 + 0.05 * self._tuning.climb_per_second * max(elapsed_s, span_s))
            self._change(min(ceiling, grown), now_s, "no peer reports; probing upwards slowly")
        return LinkState.APP_LIMITED

    @property
    def _queue_low_s(self) -> float:
        return self._tuning.queue_low_s + self._burst_s

    @property
    def _queue_high_s(self) -> float:
        return self._tuning.queue_high_s + self._burst_s

    # -- results

    def _change(self, capacity: float, now_s: float, why: str) -> None:
        self._capacity = max(capacity, 1.0)
        self._changed_at_s = now_s
        self._evidence = f"{self._capacity * 8e-6:.2f} Mbit/s: {why}"

    def _is_surprised(self, rate: float) -> bool:
        return self._kind is CapacityKind.PEER and abs(rate / self._capacity - 1) > self._tuning.surprise_ratio

    def _train_interval_s(self, size: float) -> float:
        if self._kind is not CapacityKind.PEER:
            return self._tuning.first_interval_s
        return max(1.0, size / (self._tuning.train_share * self._capacity))

    def _estimate(self, now_s: float) -> LinkEstimate:
        assert self._started_at_s is not None
        pinned = self._settings.capacity_bytes_per_second
        newest = max(self._changed_at_s, self._trains[-1][0] if self._trains else -math.inf)
        return LinkEstimate(
            capacity_bytes_per_second=pinned if pinned is not None else self._capacity,
            kind=CapacityKind.CONFIGURED if pinned is not None else self._kind,
            state=self._state,
            queue_delay_s=max(0.0, self._queue_delay_s, self._overdue_s(now_s)),
            queue_allowance_s=self._queue_low_s,
            delivery_rate_bytes_per_second=self._delivery_rate if self._state is not LinkState.OUTAGE else 0.0,
            age_s=0.0 if pinned is not None else now_s - max(newest, self._started_at_s),
            evidence="pinned by the configuration" if pinned is not None else self._evidence,
            foreign_bytes_per_second=self._foreign_rate,
            packet_overhead_s=self._settings.packet_overhead_s or 0.0,
        )
