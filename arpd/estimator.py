"""Rmax's other half: the capacity of the link, from receiver reports, probe trains and one-way delay (DESIGN §5)."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING

from arpd.estimator_tuning import EstimatorTuning
from arpd.foreign import ForeignTraffic
from arpd.hearing import Hearing
from arpd.local_queue import LocalQueue
from arpd.model import CapacityKind, LinkEstimate, LinkState
from arpd.probe_schedule import ProbeSchedule
from arpd.queue_gauge import QueueGauge, SentProbe
from arpd.trains import TrainLog
from arpd.wire import probe_wire_bytes, wire_size

if TYPE_CHECKING:
    from arpd.model import Observation
    from arpd.probe_schedule import ProbeTuning
    from arpd.probing import PeerReport, ProbeRequest
    from arpd.settings import LinkSettings

_ENOUGH_TRAINS = 3


class Estimator:
    """Estimates the link's capacity; one `update` per tick.

    Throughput alone never shows capacity, so it is believed only while a queue stands (rule *down*). Otherwise the
    dispersion of probe trains speaks (rules *first*, *undo*, *agree*, *follow*). Silence is an outage, not a capacity.

    The capacity is that of the whole link: what the peer receives while a queue stands includes foreign traffic, and a
    train, sent faster than the link, leaves others little room between its packets. So foreign traffic is subtracted
    from it. Twice for a moment where that reasoning fails: for traffic to another host than the peer, until trains
    correct the capacity; and for what a train lets in between. The bound on what is yielded bounds that, too.

    Several peers share the link: what they receive adds up, the longest queue counts, and a train crosses once for
    each of them. The trains of one are read, the one heard for the longest: a second reading would confirm nothing.

    Parameters
    ----------
    settings : pins, first belief
    tuning, probing : the constants
    """

    def __init__(
        self, settings: LinkSettings, tuning: EstimatorTuning | None = None, probing: ProbeTuning | None = None
    ) -> None:
        self._settings = settings
        self._tuning = tuning or EstimatorTuning()
        self._schedule = ProbeSchedule(probing)
        self._capacity = settings.initial_capacity_bytes_per_second
        self._before_down: float | None = None
        self._down_at_s = -math.inf
        self._changed_at_s = -math.inf
        self._evidence = "no evidence yet"
        self._kind = CapacityKind.CONFIGURED
        self._state = LinkState.APP_LIMITED
        self._started_at_s: float | None = None
        self._last_s = -math.inf
        self._reported_s = -math.inf
        self._peers: dict[str, QueueGauge] = {}  # by name, the one heard for the longest first
        self._copies = 1
        self._first_wait_s = self._tuning.first_wait_s
        self._trains = TrainLog(self._tuning.train_memory_s)
        self._local = LocalQueue(self._tuning.local_window_s)
        self._foreign = ForeignTraffic()
        self._hearing = Hearing()
        self._foreign_rate = 0.0
        self._burst_s = 0.0  # link time of the largest message, which is no queue
        self._burst_bytes = 0.0
        self._train: tuple[float, float] = (-math.inf, 0.0)  # the last one: when s, bytes on the link
        self._queue_delay_s = 0.0
        self._alarm_s = 0.0  # what the bytes say of the queue, which no ping has confirmed
        self._high_reports = 0
        self._onset_s = -math.inf

    @property
    def has_evidence(self) -> bool:
        """Whether the first plan may be made: capacity measured, pinned, or nobody there to measure it with."""
        return (
            self._kind in (CapacityKind.PEER, CapacityKind.LOCAL)
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
        self._expect_bursts(observation)
        # A peer that is there but silent may only be behind a bad link: do not plan on the first belief in haste.
        self._first_wait_s = self._tuning.peer_lost_s if observation.peers else self._tuning.first_wait_s
        self._copies = max(1, len(self._peers) if observation.peers is None else observation.peers)
        self._foreign_rate = self._foreign.update(observation)
        self._local.update(observation.counters, now_s, burst_bytes=self._burst_bytes, capacity=self._capacity)
        for report in observation.reports:
            self._digest(report)
        self._measure_queue(now_s)
        silence_s = now_s - self._reported_s
        self._hearing.note(now_s, observation.counters, is_usual=silence_s <= self._outage_s)
        if silence_s <= self._outage_s:
            self._state = self._judge(now_s, elapsed_s)
        elif silence_s <= self._tuning.peer_lost_s and observation.peers != 0 and not self._hearing.is_answered:
            self._state = LinkState.OUTAGE
        else:
            self._forget_queue()
            self._state = self._judge_alone(observation)
        return self._estimate(observation)

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:
        """Probes to send now: a ping for the delay, a train for the capacity when one is due and affordable."""
        if self._settings.capacity_bytes_per_second is not None:
            return ()
        requests = tuple(
            self._schedule.wanted(
                now_s,
                capacity_bytes_per_second=self._capacity,
                is_measured=self._kind is CapacityKind.PEER,
                is_out=self._state is LinkState.OUTAGE or not math.isfinite(self._reported_s),
                is_free=self._queue_delay_s < self._queue_low_s,
                is_urgent=self._before_down is not None and now_s - self._down_at_s < self._tuning.undo_window_s,
                surprise_bytes_per_second=self._surprise(now_s),
                needs_pair=self._settings.packet_overhead_s is None and self._trains.needs_pairs,
                copies=self._copies,
            )
        )
        for request in requests:
            self._foreign.note_probe(request, now_s, peers=self._copies)
            if request.packets > 1:
                self._train = now_s, self._copies * request.packets * probe_wire_bytes(request.packet_bytes)
            probe = SentProbe(
                number=request.number,
                sent_s=now_s,
                handed_bytes=self._local.handed_bytes,
                is_ping=request.packets == 1,
            )
            for peer in self._peers.values():
                peer.note_sent(probe)
        return requests

    # -- evidence

    def _expect_bursts(self, observation: Observation) -> None:
        """Say how much may stand before the link without being a queue."""
        sizes = [
            publisher.copies * wire_size(publisher.payload_bytes, rate_hz=math.inf)[0]
            for publisher in observation.publishers
            if publisher.payload_bytes > 0
        ]
        train_bytes = self._train[1] if observation.now_s - self._train[0] < self._tuning.train_is_near_s else 0.0
        largest = max(sizes, default=0.0)
        self._burst_bytes = max(self._tuning.burst_bytes, self._tuning.burst_share * largest) + train_bytes
        self._burst_s = min(self._tuning.burst_cap_s, largest / self._capacity)

    def _digest(self, report: PeerReport) -> None:
        t, now_s = self._tuning, report.received_at_s
        silent_s = now_s - self._reported_s
        if t.outage_forget_s < silent_s < math.inf:
            self._resume(now_s, silent_s)
        self._reported_s = now_s
        self._peers = {
            name: peer
            for name, peer in self._peers.items()
            if now_s - peer.reported_s <= t.outage_forget_s or name == report.peer
        }
        if report.peer not in self._peers:
            self._peers[report.peer] = QueueGauge(t)
        peer = self._peers[report.peer]
        # With several, the bytes that one did not receive may be another's.
        peer.digest(report, handed_bytes=self._local.handed_bytes if len(self._peers) == 1 else None)
        if report.delays_s:
            self._high_reports = self._high_reports + 1 if peer.delay_s > self._queue_high_s else 0
        if peer is next(iter(self._peers.values())):
            for train in report.trains:
                self._trains.note(train, now_s, copies=self._copies)

    def _measure_queue(self, now_s: float) -> None:
        was_quiet = self._queue_delay_s <= self._queue_high_s
        ledgers = (
            peer.backlog_s(now_s, burst_bytes=self._burst_bytes, capacity_bytes_per_second=self._capacity)
            for peer in self._peers.values()
        )
        # While nothing arrives, what is lost looks like what waits.
        is_out = now_s - self._reported_s > self._outage_s
        self._alarm_s = 0.0 if is_out else max(self._local.backlog_s, *ledgers, 0.0)
        delay_s = max((max(peer.delay_s, peer.overdue_s(now_s)) for peer in self._peers.values()), default=0.0)
        self._queue_delay_s = max(0.0, delay_s, self._alarm_s)
        if was_quiet and self._queue_delay_s > self._queue_high_s:
            self._onset_s = now_s  # what was delivered before is demand, not capacity

    def _forget_queue(self) -> None:
        """Nobody measures the queue any more; its last length must not hold the gate."""
        for peer in self._peers.values():
            peer.forget()
        self._queue_delay_s = self._alarm_s = self._local.backlog_s
        self._high_reports = 0

    def _resume(self, now_s: float, silent_s: float) -> None:
        self._forget_queue()
        self._trains.clear()
        self._onset_s = now_s  # reports that waited tell of the outage
        self._foreign.note_outage(now_s - silent_s, now_s)
        if self._kind is CapacityKind.PEER:
            self._before_down, self._down_at_s = self._capacity, now_s
            self._change(
                self._tuning.resume_ratio * self._capacity, now_s, f"reports resumed after {silent_s:.1f} s of silence"
            )

    def _delivery(self, since_s: float = -math.inf) -> tuple[float, float]:
        """Return what all peers received lately, or lately and since then: bytes/s and packets/s."""
        each = [peer.delivery(since_s) for peer in self._peers.values()]
        return sum(size for size, _ in each), sum(packets for _, packets in each)

    # -- the rules

    def _judge(self, now_s: float, elapsed_s: float) -> LinkState:
        """With a peer that reports: the rules down, first, undo, agree and follow."""
        t = self._tuning
        if self._is_certain():
            return self._queue_stands(now_s)
        if self._queue_delay_s > self._queue_low_s:
            return self._congested(now_s)
        recent = self._capacities(now_s - t.train_window_s)
        if self._kind is not CapacityKind.PEER:
            if len(recent) >= _ENOUGH_TRAINS:
                self._kind = CapacityKind.PEER
                self._change(median(recent), now_s, f"first {len(recent)} trains")
            return LinkState.APP_LIMITED
        if not (self._undo(now_s) or self._agree(now_s) or self._carried(now_s)):
            trains = recent if len(recent) >= _ENOUGH_TRAINS else self._capacities(-math.inf)[-_ENOUGH_TRAINS:]
            if len(trains) >= _ENOUGH_TRAINS and now_s - self._down_at_s >= t.up_after_down_s:
                self._follow(trains, now_s, elapsed_s)
        busy = self._delivery()[0] > 0.8 * self._settings.headroom * self._capacity
        return LinkState.STEADY if busy else LinkState.APP_LIMITED

    def _is_certain(self) -> bool:
        """Whether a queue stands: two pings say so, or the bytes and somebody else."""
        if self._high_reports >= 2:
            return True
        if self._alarm_s <= self._queue_high_s:
            return False
        is_steady = any(peer.is_steady(self._onset_s) for peer in self._peers.values())
        return self._high_reports == 1 or self._local.stands or is_steady

    def _congested(self, now_s: float) -> LinkState:
        is_draining = now_s - self._down_at_s < self._tuning.undo_window_s
        return LinkState.DRAINING if is_draining else LinkState.CONGESTED

    def _queue_stands(self, now_s: float) -> LinkState:
        """Believe what is delivered while the link is never idle, the time its packets cost taken out."""
        t = self._tuning
        rate, packet_rate = self._delivery(self._onset_s)
        rate /= max(0.1, 1.0 - packet_rate * self._overhead_s)
        if rate > 0 and now_s - self._down_at_s >= t.down_interval_s:
            why = f"queue of {self._queue_delay_s * 1e3:.0f} ms at this delivery rate"
            if rate < t.down_margin * self._capacity:
                if now_s - self._down_at_s > t.undo_window_s or self._before_down is None:
                    self._before_down = self._capacity
                self._kind = CapacityKind.PEER
                self._down_at_s = now_s
                self._change(rate, now_s, why)
                # Trains from before say nothing of the link that is now.
                self._trains.clear()
            elif rate * t.down_margin > self._capacity:
                self._change(rate, now_s, why)
        return self._congested(now_s)

    def _undo(self, now_s: float) -> bool:
        """Return to what was before the last fall when two trains since then saw nearly as much."""
        t = self._tuning
        if self._before_down is None or now_s - self._down_at_s > t.undo_window_s:
            return False
        later = self._capacities(self._down_at_s)[-2:]
        if len(later) < 2 or min(later) < t.undo_ratio * self._before_down or min(later) < self._capacity:
            return False
        self._change(min(later), now_s, "trains contradict the last fall")
        self._before_down = None
        return True

    def _agree(self, now_s: float) -> bool:
        """Go at once to what the last two trains agree on, if it is clearly more: two do not err upwards together."""
        t = self._tuning
        last = self._capacities(now_s - t.agree_window_s)[-2:]
        if len(last) < 2 or t.caution * min(last) <= t.clearly_more * self._capacity:
            return False
        self._before_down = None
        self._change(t.caution * min(last), now_s, f"two trains see {min(last) * 8e-6:.1f} Mbit/s")
        return True

    def _carried(self, now_s: float) -> bool:
        """Believe at least what was sent and arrived; what a peer receives from others is no evidence."""
        t = self._tuning
        rate = t.caution * min(self._delivery()[0], self._local.sent_bytes_per_second)
        if rate <= t.clearly_more * self._capacity:
            return False
        self._change(rate, now_s, "more than what was believed arrived")
        return True

    def _follow(self, trains: list[float], now_s: float, elapsed_s: float) -> None:
        """Move towards what trains see, by a bounded part per second either way.

        A sample that lands inside a train makes it read low, never high: one low train is no evidence of a fall, so
        the estimate follows downwards only what the best of the last three still sees.
        """
        step = self._tuning.climb_per_second * elapsed_s
        middle, best = median(trains), max(trains[-_ENOUGH_TRAINS:])
        if middle > self._capacity:
            self._change(min(middle, self._capacity * (1 + step)), now_s, f"trains see {middle * 8e-6:.1f} Mbit/s")
        elif best < self._tuning.fall_ratio * self._capacity:
            self._change(max(best, self._capacity * (1 - step)), now_s, f"trains see {best * 8e-6:.1f} Mbit/s")

    def _judge_alone(self, observation: Observation) -> LinkState:
        """Without a peer: what leaves while the local queue pushes back is the capacity; else nothing is learnt."""
        counters, now_s = observation.counters, observation.now_s
        if counters is None or not counters.is_up:
            return LinkState.OUTAGE
        if (told := self._local.pushes_back(observation)) is None:
            return LinkState.CONGESTED if self._local.stands else LinkState.APP_LIMITED
        pushes_back, sent = told
        if pushes_back and sent > 0:
            self._kind = CapacityKind.LOCAL
            self._change(sent, now_s, "local queue pushed back at this send rate")
            return LinkState.CONGESTED
        if self._kind is not CapacityKind.CONFIGURED:
            self._kind = CapacityKind.LOCAL
            ceiling = max(self._settings.initial_capacity_bytes_per_second, self._capacity)
            grown = self._capacity * (1 + self._tuning.alone_climb_per_second * self._tuning.local_window_s)
            self._change(min(ceiling, grown), now_s, "no peer reports; probing upwards slowly")
        return LinkState.APP_LIMITED

    @property
    def _outage_s(self) -> float:
        """Silence that is an outage: more than a report that is lost (s)."""
        return max(self._tuning.outage_s, 1.6 * self._schedule.quiet_s)

    @property
    def _queue_low_s(self) -> float:
        return self._tuning.queue_low_s + self._burst_s

    @property
    def _queue_high_s(self) -> float:
        return self._tuning.queue_high_s + self._burst_s

    # -- results

    @property
    def _overhead_s(self) -> float:
        pinned = self._settings.packet_overhead_s
        return self._trains.packet_overhead_s if pinned is None else pinned

    def _capacities(self, since_s: float) -> list[float]:
        return self._trains.capacities(since_s, packet_overhead_s=self._overhead_s)

    def _change(self, capacity: float, now_s: float, why: str) -> None:
        self._capacity = max(capacity, 1.0)
        self._changed_at_s = now_s
        self._evidence = f"{self._capacity * 8e-6:.2f} Mbit/s: {why}"

    def _surprise(self, now_s: float) -> float | None:
        """Return what the last train saw, if that is far from what is believed (bytes/s)."""
        last = self._capacities(now_s - self._tuning.agree_window_s)[-1:]
        return last[0] if last and abs(last[0] / self._capacity - 1) > self._tuning.surprise else None

    def _estimate(self, observation: Observation) -> LinkEstimate:
        assert self._started_at_s is not None
        now_s = observation.now_s
        capacity, kind, evidence = self._capacity, self._kind, self._evidence
        radio = observation.radio_bytes_per_second
        if radio is not None and kind is not CapacityKind.PEER and self._tuning.radio_share * radio < capacity:
            capacity, kind = self._tuning.radio_share * radio, CapacityKind.RADIO
            evidence = f"{capacity * 8e-6:.2f} Mbit/s: the radio sends at {radio * 8e-6:.1f} Mbit/s"
        age_s = now_s - max(self._changed_at_s, self._trains.newest_s or -math.inf, self._started_at_s)
        if (pinned := self._settings.capacity_bytes_per_second) is not None:
            capacity, kind, evidence, age_s = pinned, CapacityKind.CONFIGURED, "pinned by the configuration", 0.0
        return LinkEstimate(
            capacity_bytes_per_second=capacity,
            kind=kind,
            state=self._state,
            queue_delay_s=self._queue_delay_s,
            queue_allowance_s=self._queue_low_s,
            delivery_rate_bytes_per_second=0.0 if self._state is LinkState.OUTAGE else self._delivery()[0],
            age_s=age_s,
            evidence=evidence,
            foreign_bytes_per_second=self._foreign_rate,
            packet_overhead_s=self._overhead_s,
        )
