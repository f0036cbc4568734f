"""Rmax: the capacity of the link, from receiver reports, probe trains and delay (docs/design.md, The estimator)."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING

from arpd.estimate.belief import Belief
from arpd.estimate.cross_traffic import CrossTraffic
from arpd.estimate.local_queue import LocalQueue
from arpd.estimate.parameters import EstimatorParameters
from arpd.estimate.peer_queue import PeerGauges, SentProbe
from arpd.estimate.probes import ProbeLoss, ProbeSchedule
from arpd.estimate.silence import Silence
from arpd.estimate.trains import TrainLog
from arpd.model.link import CapacityKind, EstimatorEvent, LinkEstimate, LinkState
from arpd.model.wire import probe_wire_bytes, wire_size

if TYPE_CHECKING:
    from arpd.estimate.probes import ProbeParameters
    from arpd.model.observation import Observation
    from arpd.model.probing import PeerReport, ProbeRequest
    from arpd.model.settings import LinkSettings

_ENOUGH_TRAINS = 3


class Estimator:
    """Estimates the link's capacity; one `update` per tick.

    Throughput alone never shows capacity, so delivery counts only while a queue stands (rule *down*). Otherwise the
    dispersion of probe trains counts (rules *first*, *undo*, *agree*, *follow*). Silence is an outage, not a capacity.

    The capacity is that of the whole link: a peer under a standing queue also receives cross traffic, and a train
    leaves faster than the link and gives others little room between its packets. So cross traffic is subtracted. This
    over-subtracts briefly in two cases: cross traffic to another host than the peer, until trains correct the
    capacity, and cross traffic inside a train. `MOST_YIELDED` bounds both.

    Several peers share the link: what they receive adds up, and the longest queue counts. A train crosses the link once
    per peer, but only the longest-known peer's reading counts: the others would confirm nothing.

    Parameters
    ----------
    settings : pinned values, and the capacity to assume at first
    parameters, probing : constants of the rules and of the probes
    """

    def __init__(
        self,
        settings: LinkSettings,
        parameters: EstimatorParameters | None = None,
        probing: ProbeParameters | None = None,
    ) -> None:
        self._settings = settings
        self._parameters = parameters or EstimatorParameters()
        self._schedule = ProbeSchedule(probing)
        self._belief = Belief(settings.initial_capacity_bytes_per_second)
        self._before_down: float | None = None
        self._down_at_s = -math.inf
        self._state = LinkState.APP_LIMITED
        self._started_at_s: float | None = None
        self._last_s = self._reported_s = -math.inf
        self._peers = PeerGauges(self._parameters)
        self._loss = ProbeLoss()
        self._copies = 1
        self._first_wait_s = self._parameters.first_wait_s
        self._trains = TrainLog(self._parameters.train_memory_s)
        self._local = LocalQueue(self._parameters.local_window_s)
        self._cross_traffic = CrossTraffic()
        self._silence = Silence()
        self._cross_traffic_rate = 0.0
        self._burst_s = 0.0  # link time of the largest message; so much is no queue
        self._burst_bytes = 0.0
        self._train: tuple[float, float] = (-math.inf, 0.0)  # the last one: departure s, bytes on the link
        self._queue_delay_s = 0.0
        self._alarm_s = 0.0  # queue by the bytes, before a ping confirms it
        self._high_reports = 0
        self._onset_s = -math.inf

    @property
    def has_evidence(self) -> bool:
        """True when the first plan may be made: the capacity is measured or pinned, or the wait for a peer is over."""
        return (
            self._belief.kind in (CapacityKind.PEER, CapacityKind.LOCAL)
            or self._settings.capacity_bytes_per_second is not None
            or (self._started_at_s is not None and self._last_s - self._started_at_s > self._first_wait_s)
        )

    def reconfigure(self, settings: LinkSettings) -> None:
        """Take new settings; measurements stay."""
        self._settings = settings
        if self._belief.kind is CapacityKind.CONFIGURED:
            self._belief.capacity = settings.initial_capacity_bytes_per_second
        if settings.capacity_bytes_per_second is not None:
            self._forget_queue()

    def update(self, observation: Observation) -> LinkEstimate:
        """Digest one observation and return the estimate."""
        now_s, was_out = observation.now_s, self._state is LinkState.OUTAGE
        if self._started_at_s is None:
            self._started_at_s = now_s
        elapsed_s = max(0.0, min(1.0, now_s - self._last_s))
        self._last_s = now_s
        self._expect_bursts(observation)
        # A silent peer in the graph may be behind a bad link, so the first plan waits longer for it.
        self._first_wait_s = self._parameters.peer_lost_s if observation.peers else self._parameters.first_wait_s
        self._copies = max(1, len(self._peers) if observation.peers is None else observation.peers)
        self._cross_traffic_rate = self._cross_traffic.update(observation)
        self._local.update(observation.counters, now_s, burst_bytes=self._burst_bytes, capacity=self._capacity)
        for report in observation.reports:
            self._digest(report)
        self._measure_queue(now_s)
        silence_s = now_s - self._reported_s
        self._silence.note(now_s, observation.counters, is_usual=silence_s <= self._outage_s)
        if silence_s <= self._outage_s:
            self._state = self._judge(now_s, elapsed_s)
        elif self._silence.is_cut or (
            silence_s <= self._parameters.peer_lost_s and observation.peers != 0 and not self._silence.is_answered
        ):
            self._state = LinkState.OUTAGE
        else:
            self._forget_queue()
            self._state = self._judge_alone(observation)
        if self._state is LinkState.OUTAGE and not was_out:
            self._belief.note(EstimatorEvent.OUTAGE)
        return self._estimate(observation)

    def wanted_probes(self, now_s: float) -> tuple[ProbeRequest, ...]:
        """Return the probes to send now: pings for the delay, trains for the capacity where due and affordable."""
        if self._settings.capacity_bytes_per_second is not None:
            return ()
        requests = tuple(
            self._schedule.wanted(
                now_s,
                capacity_bytes_per_second=self._capacity,
                is_measured=self._belief.kind is CapacityKind.PEER,
                is_out=self._state is LinkState.OUTAGE or not math.isfinite(self._reported_s),
                is_free=self._queue_delay_s < self._queue_low_s,
                is_urgent=self._before_down is not None and now_s - self._down_at_s < self._parameters.undo_window_s,
                surprise_bytes_per_second=self._surprise(now_s),
                needs_pair=self._settings.packet_overhead_s is None and self._trains.needs_pairs,
                copies=self._copies,
            )
        )
        for request in requests:
            self._cross_traffic.note_probe(request, now_s, peers=self._copies)
            if request.packets > 1:
                self._train = now_s, self._copies * request.packets * probe_wire_bytes(request.packet_bytes)
            probe = SentProbe(
                number=request.number, sent_s=now_s, handed_bytes=self._local.handed_bytes, is_ping=request.packets == 1
            )
            self._peers.note_sent(probe)
            self._loss.note_sent(request)
        return requests

    # -- evidence

    def _expect_bursts(self, observation: Observation) -> None:
        """Compute how much may stand before the link without being a queue."""
        sizes = [
            publisher.copies * wire_size(publisher.payload_bytes, rate_hz=math.inf)[0]
            for publisher in observation.publishers
            if publisher.payload_bytes > 0
        ]
        train_bytes = self._train[1] if observation.now_s - self._train[0] < self._parameters.train_is_near_s else 0.0
        largest = max(sizes, default=0.0)
        self._burst_bytes = max(self._parameters.burst_bytes, self._parameters.burst_share * largest) + train_bytes
        self._burst_s = min(self._parameters.burst_cap_s, largest / self._capacity)

    def _digest(self, report: PeerReport) -> None:
        p, now_s = self._parameters, report.received_at_s
        silent_s = now_s - self._reported_s
        if p.outage_forget_s < silent_s < math.inf:
            self._resume(now_s, silent_s)
        self._reported_s = now_s
        self._loss.digest(report)
        peer = self._peers.digest(report, handed_bytes=self._local.handed_bytes)
        if report.delays_s:
            self._high_reports = self._high_reports + 1 if peer.delay_s > self._queue_high_s else 0
        if self._peers.is_first(report.peer):
            for train in report.trains:
                self._trains.note(train, now_s, copies=self._copies)

    def _measure_queue(self, now_s: float) -> None:
        was_quiet = self._queue_delay_s <= self._queue_high_s
        backlog_s = self._peers.backlog_s(
            now_s, burst_bytes=self._burst_bytes, capacity_bytes_per_second=self._capacity
        )
        # While nothing arrives, lost bytes look like waiting ones.
        is_out = now_s - self._reported_s > self._outage_s
        self._alarm_s = 0.0 if is_out else max(self._local.backlog_s, backlog_s, 0.0)
        self._queue_delay_s = max(0.0, self._peers.delay_s(now_s), self._alarm_s)
        if was_quiet and self._queue_delay_s > self._queue_high_s:
            self._onset_s = max(self._onset_s, now_s)  # what was delivered before is demand, not capacity

    def _forget_queue(self) -> None:
        """Forget a queue that no peer measures now; its last length must not hold the gate."""
        self._peers.forget()
        self._queue_delay_s = self._alarm_s = self._local.backlog_s
        self._high_reports = 0

    def _resume(self, now_s: float, silent_s: float) -> None:
        self._forget_queue()
        self._trains.clear()
        # Reports that waited describe the outage, and the first delivery is only what the gate let pass.
        self._onset_s = now_s + self._parameters.resume_patience_s
        self._cross_traffic.note_outage(now_s - silent_s, now_s)
        if self._belief.kind is CapacityKind.PEER:
            self._before_down, self._down_at_s = self._capacity, now_s
            resumed = self._parameters.resume_ratio * self._capacity
            why = f"reports resumed after {silent_s:.1f} s of silence"
            self._belief.change(EstimatorEvent.RESUME, now_s, resumed, why)

    # -- the rules

    def _judge(self, now_s: float, elapsed_s: float) -> LinkState:
        """Apply the rules down, first, undo, agree, carried and follow while a peer reports."""
        p = self._parameters
        if self._is_certain():
            return self._queue_stands(now_s)
        if self._queue_delay_s > self._queue_low_s:
            return self._congested(now_s)
        recent = self._capacities(now_s - p.train_window_s)
        if self._belief.kind is not CapacityKind.PEER:
            if len(recent) >= _ENOUGH_TRAINS:
                self._belief.kind = CapacityKind.PEER
                self._belief.change(EstimatorEvent.FIRST, now_s, median(recent), f"first {len(recent)} trains")
            return LinkState.APP_LIMITED
        if not (self._undo(now_s) or self._agree(now_s) or self._carried(now_s)):
            trains = recent if len(recent) >= _ENOUGH_TRAINS else self._capacities(-math.inf)[-_ENOUGH_TRAINS:]
            if len(trains) >= _ENOUGH_TRAINS and now_s - self._down_at_s >= p.up_after_down_s:
                self._follow(trains, now_s, elapsed_s)
        busy = self._peers.delivery(-math.inf)[0] > 0.8 * self._settings.headroom * self._capacity
        return LinkState.STEADY if busy else LinkState.APP_LIMITED

    def _is_certain(self) -> bool:
        """Return whether a queue stands: two reports of pings show it, or the bytes and one other witness."""
        if self._high_reports >= 2:
            return True
        if self._alarm_s <= self._queue_high_s:
            return False
        return self._high_reports == 1 or self._local.stands or self._peers.is_steady(self._onset_s)

    def _congested(self, now_s: float) -> LinkState:
        is_draining = now_s - self._down_at_s < self._parameters.undo_window_s
        return LinkState.DRAINING if is_draining else LinkState.CONGESTED

    def _queue_stands(self, now_s: float) -> LinkState:
        """Take the delivery as the capacity: the link is never idle. The time of packet overhead does not count."""
        p = self._parameters
        rate, packet_rate = self._peers.delivery(self._onset_s)
        rate /= max(0.1, 1.0 - packet_rate * self._overhead_s)
        if rate > 0 and now_s - self._down_at_s >= p.down_interval_s:
            why = f"queue of {self._queue_delay_s * 1e3:.0f} ms at this delivery rate"
            if rate < p.down_margin * self._capacity:
                if now_s - self._down_at_s > p.undo_window_s or self._before_down is None:
                    self._before_down = self._capacity
                self._belief.kind = CapacityKind.PEER
                self._down_at_s = now_s
                self._belief.change(EstimatorEvent.DOWN, now_s, rate, why)
                # Earlier trains measured another link.
                self._trains.clear()
            elif rate * p.down_margin > self._capacity:
                self._belief.change(EstimatorEvent.CARRIED, now_s, rate, why)
        return self._congested(now_s)

    def _undo(self, now_s: float) -> bool:
        """Return to the capacity before the last fall when two trains since then saw nearly as much."""
        p = self._parameters
        if self._before_down is None or now_s - self._down_at_s > p.undo_window_s:
            return False
        later = self._capacities(self._down_at_s)[-2:]
        if len(later) < 2 or min(later) < p.undo_ratio * self._before_down or min(later) < self._capacity:
            return False
        self._belief.change(EstimatorEvent.UNDO, now_s, min(later), "trains contradict the last fall")
        self._before_down = None
        return True

    def _agree(self, now_s: float) -> bool:
        """Jump to what the last two trains agree on, if it is clearly more: two do not err upwards together."""
        p = self._parameters
        last = self._capacities(now_s - p.agree_window_s)[-2:]
        if len(last) < 2 or p.caution * min(last) <= p.clearly_more * self._capacity:
            return False
        self._before_down = None
        self._belief.change(
            EstimatorEvent.AGREE, now_s, p.caution * min(last), f"two trains see {min(last) * 8e-6:.1f} Mbit/s"
        )
        return True

    def _carried(self, now_s: float) -> bool:
        """Rise to what this host sent and peers received; bytes from other senders are no evidence."""
        p = self._parameters
        rate = p.caution * min(self._peers.delivery(-math.inf)[0], self._local.sent_bytes_per_second)
        if rate <= p.clearly_more * self._capacity:
            return False
        self._belief.change(EstimatorEvent.CARRIED, now_s, rate, "more arrived than was believed")
        return True

    def _follow(self, trains: list[float], now_s: float, elapsed_s: float) -> None:
        """Move towards what trains see, by a bounded part per second.

        A sample inside a train makes it read low, never high. So one low train is no evidence of a fall, and downwards
        the estimate follows only the best of the last three.
        """
        step = self._parameters.climb_per_second * elapsed_s
        middle, best = median(trains), max(trains[-_ENOUGH_TRAINS:])
        if middle > self._capacity:
            seen, moved = middle, min(middle, self._capacity * (1 + step))
        elif best < self._parameters.fall_ratio * self._capacity:
            seen, moved = best, max(best, self._capacity * (1 - step))
        else:
            return
        self._belief.change(EstimatorEvent.FOLLOW, now_s, moved, f"trains see {seen * 8e-6:.1f} Mbit/s")

    def _judge_alone(self, observation: Observation) -> LinkState:
        """Judge without a peer: what leaves while the local queue pushes back is the capacity."""
        counters, now_s = observation.counters, observation.now_s
        if counters is None or not counters.is_up:
            return LinkState.OUTAGE
        if (window := self._local.pushes_back(observation)) is None:
            return LinkState.CONGESTED if self._local.stands else LinkState.APP_LIMITED
        pushes_back, sent = window
        if pushes_back and sent > 0:
            self._belief.kind = CapacityKind.LOCAL
            self._belief.change(EstimatorEvent.LOCAL, now_s, sent, "local queue pushed back at this send rate")
            return LinkState.CONGESTED
        if self._belief.kind is not CapacityKind.CONFIGURED:
            self._belief.kind = CapacityKind.LOCAL
            ceiling = max(self._settings.initial_capacity_bytes_per_second, self._capacity)
            grown = self._capacity * (1 + self._parameters.alone_climb_per_second * self._parameters.local_window_s)
            self._belief.change(
                EstimatorEvent.LOCAL, now_s, min(ceiling, grown), "no peer reports; probing upwards slowly"
            )
        return LinkState.APP_LIMITED

    @property
    def _outage_s(self) -> float:
        """Silence that is an outage: longer than one lost report explains (s)."""
        return max(self._parameters.outage_s, 1.6 * self._schedule.quiet_s)

    @property
    def _queue_low_s(self) -> float:
        return self._parameters.queue_low_s + self._burst_s

    @property
    def _queue_high_s(self) -> float:
        return self._parameters.queue_high_s + self._burst_s

    # -- results

    @property
    def _capacity(self) -> float:
        return self._belief.capacity

    @property
    def _overhead_s(self) -> float:
        pinned = self._settings.packet_overhead_s
        return self._trains.packet_overhead_s if pinned is None else pinned

    def _capacities(self, since_s: float) -> list[float]:
        return self._trains.capacities(since_s, packet_overhead_s=self._overhead_s)

    def _surprise(self, now_s: float) -> float | None:
        """Return what the last train saw, if that is far from the capacity (bytes/s)."""
        last = self._capacities(now_s - self._parameters.agree_window_s)[-1:]
        return last[0] if last and abs(last[0] / self._capacity - 1) > self._parameters.surprise else None

    def _estimate(self, observation: Observation) -> LinkEstimate:
        assert self._started_at_s is not None
        now_s = observation.now_s
        since_s = max(self._trains.newest_s or -math.inf, self._started_at_s)
        capacity, kind, evidence, age_s = self._belief.stated(
            now_s,
            since_s=since_s,
            pinned=self._settings.capacity_bytes_per_second,
            radio=observation.radio_bytes_per_second,
            radio_share=self._parameters.radio_share,
        )
        is_out = self._state is LinkState.OUTAGE
        return LinkEstimate(
            capacity_bytes_per_second=capacity,
            kind=kind,
            state=self._state,
            queue_delay_s=self._queue_delay_s,
            queue_allowance_s=self._queue_low_s,
            delivery_rate_bytes_per_second=0.0 if is_out else self._peers.delivery(-math.inf)[0],
            age_s=age_s,
            evidence=evidence,
            cross_traffic_bytes_per_second=self._cross_traffic_rate,
            packet_overhead_s=self._overhead_s,
            # In an outage nobody knows whether unanswered probes are lost.
            loss_ratio=None if is_out else self._loss.ratio(now_s),
            return_delay_s=None if is_out else self._peers.return_delay_s,
            events_by_kind=self._belief.events_by_kind,
        )
