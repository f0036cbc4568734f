"""Rmax: the capacity of the link, from receiver reports, probe trains and delay (docs/design.md, The estimator)."""

from __future__ import annotations

import math
from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

from arpd.estimate import parameters
from arpd.estimate.capacity import Statement
from arpd.estimate.cross_traffic import CrossTraffic
from arpd.estimate.local_queue import LocalQueue, QueuePast
from arpd.estimate.peer_queue import PeerGauges, SentPing
from arpd.estimate.probes import ProbeLoss, ProbeSchedule
from arpd.estimate.receiver import LONGEST_QUIET_S
from arpd.estimate.silence import Silence
from arpd.estimate.trains import TrainLog
from arpd.model.link import CapacityKind, LinkEstimate, LinkState
from arpd.model.quantities import format_duration, format_rate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.endpoints import PublisherState
    from arpd.model.interface import LinkCounters
    from arpd.model.observation import Observation
    from arpd.model.probing import PeerReport, ProbeRequest
    from arpd.model.settings import LinkSettings

_ENOUGH_TRAINS = 3
_SETTLED = 8  # large trains that show the capacity of a link that rests, also in the light of an overhead just found


class Estimator:
    """Estimates the link's capacity; one `update` per tick.

    Throughput alone never shows capacity. So four kinds of evidence meet in one `CapacityBelief`: what arrives while a
    queue stands (two-sided), the dispersion of probe trains (biased low), what was carried at all (a lower bound), and
    whether pings meet a queue (a link that carries R is idle for 1 − R/C of the time). Silence is no capacity.

    The capacity is that of the whole link: a peer under a standing queue also receives cross traffic, and a train
    leaves faster than the link and gives others little room between its packets. So cross traffic is subtracted. This
    over-subtracts briefly in two cases: cross traffic to another host than the peer, until trains correct the
    capacity, and cross traffic inside a train. `MOST_YIELDED` bounds both.

    Several peers share the link: what they receive adds up, and the longest queue counts. A train crosses the link once
    per peer, but only the longest-known peer's reading counts: the others would confirm nothing.

    Parameters
    ----------
    settings : pinned values, and the capacity to assume at first
    """

    def __init__(self, settings: LinkSettings) -> None:
        self._settings = settings
        self._schedule = ProbeSchedule()
        self._asked: deque[ProbeRequest] = deque(maxlen=100)  # probes from the last one on that a peer has
        self._stated = Statement(settings.initial_capacity_bytes_per_second)
        self._radio: float | None = None  # bit rate (bytes/s)
        self._state = LinkState.APP_LIMITED
        self._started_at_s = math.inf
        self._last_s = self._reported_s = -math.inf
        self._interval_s = 0.0  # of the last report
        self._is_silent = True  # for longer than one lost report explains
        self._peers = PeerGauges()
        self._loss = ProbeLoss()
        self._copies = 1
        self._first_wait_s = parameters.FIRST_WAIT_S
        self._trains = TrainLog()
        self._local = LocalQueue()
        self._cross_traffic = CrossTraffic()
        self._silence = Silence()
        self._publishers: Sequence[PublisherState] = ()  # whose largest sample is known
        self._largest_bytes = 0.0  # on the link, in all its copies
        self._pinged: list[float] = []
        self._queue_delay_s = self._alarm_s = 0.0  # the second by the bytes, before a ping confirms it
        self._heard_queue_s = 0.0  # the queue while a peer was heard last
        self._queues = QueuePast()
        self._used_s = math.inf  # when more than next to nothing left or arrived last

    @property
    def has_evidence(self) -> bool:
        """True when the first plan may be made: the capacity is measured or pinned, or the wait for a peer is over."""
        return (
            self._stated.kind in {CapacityKind.PEER, CapacityKind.LOCAL}
            or self._is_pinned
            or self._last_s - self._started_at_s > self._first_wait_s
        )

    def reconfigure(self, settings: LinkSettings) -> None:
        """Take new settings; measurements stay, but for those that another overhead of a packet made."""
        has_other_overhead = settings.packet_overhead_s != self._settings.packet_overhead_s
        self._settings, initial = settings, settings.initial_capacity_bytes_per_second
        if self._stated.kind is CapacityKind.CONFIGURED:
            self._stated = Statement(initial)
        elif has_other_overhead:
            self._trains.clear()
            self._stated = Statement(min(self._stated.capacity, initial))
        if self._is_pinned:
            self._forget_queue()
            self._asked.clear()

    def update(self, observation: Observation) -> LinkEstimate:
        """Digest one observation and return the estimate."""
        now_s = observation.now_s
        self._started_at_s, self._last_s = min(self._started_at_s, now_s), now_s
        self._radio = observation.radio_bytes_per_second
        capacity, local = self._capacity, self._local
        publishers = () if observation.relay else observation.publishers
        if publishers is not self._publishers:
            self._publishers = publishers
            self._largest_bytes = max((each.wire_bytes(math.inf) for each in publishers), default=0.0)
        moved = max(self._peers.delivery()[0], local.sent_bytes_per_second())
        moved -= self._cross_traffic.probe_bytes(now_s - parameters.SHOWS_S) / parameters.DELIVERY_WINDOW_S
        self._used_s = now_s if moved > parameters.RESTING * capacity else min(self._used_s, now_s)
        # A silent peer in the graph may be behind a bad link, so the first plan waits longer for it.
        if not self.has_evidence:
            self._first_wait_s = parameters.PEER_LOST_S if observation.peers else parameters.FIRST_WAIT_S
        self._copies = max(1, len(self._peers) if observation.peers is None else observation.peers)
        cross_traffic = self._cross_traffic.update(observation)
        local.update(observation.counters, now_s, burst_bytes=self._burst_bytes, capacity=capacity)
        for report in observation.reports:
            self._digest(report)
        silence_s = now_s - self._reported_s
        self._is_silent = silence_s > self._outage_s
        self._measure_queue(now_s)
        self._learn(now_s, has_reports=bool(observation.reports))
        self._silence.note(now_s, observation.counters, is_usual=not self._is_silent)
        # Behind a queue of seconds a peer is late, and not dead, however much of the little that passes is answered.
        may_be_dead = self._silence.is_answered and self._heard_queue_s < parameters.LATE_QUEUE_S
        if not self._is_silent:
            self._state, self._heard_queue_s = self._judge(now_s), self._queue_delay_s
        elif self._silence.is_cut or (
            silence_s <= parameters.PEER_LOST_S and observation.peers != 0 and not may_be_dead
        ):
            self._state = LinkState.OUTAGE
        else:
            self._forget_queue()
            self._state = self._judge_alone(now_s, observation.counters)
        if self._state is LinkState.OUTAGE:
            self._cross_traffic.bound(now_s + parameters.RESENDS_S)
        return self._estimate(now_s, cross_traffic)

    def wanted_probes(self, now_s: float, *, is_short: bool) -> tuple[ProbeRequest, ...]:
        """Return the probes to send now: pings for the delay, trains for the capacity where due and affordable.

        Parameters
        ----------
        is_short : True while topics ask for more than the link is believed to carry
        """
        if self._is_pinned:
            return ()
        # Trains for a peer that returns are not paid for. On a dying link, which fell silent, they would pile up: one
        # waits until a peer reports a probe that left after the last train.
        is_under_way = any(request.packets > 1 for request in islice(self._asked, 1, None))
        waits = self._stated.kind is CapacityKind.LOCAL and is_under_way
        requests = tuple(
            self._schedule.wanted(
                now_s,
                capacity=self._capacity,
                is_measured=self._stated.kind is CapacityKind.PEER,
                is_out=self._state is LinkState.OUTAGE or not math.isfinite(self._reported_s),
                is_free=self._queue_delay_s < self._queue_low_s and not waits,
                is_urgent=now_s - self._stated.fell_at_s < parameters.URGENT_S,
                needs_pair=self._settings.packet_overhead_s is None and self._trains.needs_pairs,
                copies=self._copies,
                is_short=is_short,
                is_resting=self._is_resting and self._trains.count >= _SETTLED,
            )
        )
        for request in requests:
            self._cross_traffic.note_probe(request, now_s, peers=self._copies)
            if request.packets == 1:
                self._peers.note_sent(SentPing(request.number, now_s, self._local.handed_bytes))
            self._loss.note_sent(request)
        self._asked.extend(requests)
        return requests

    # -- evidence

    def _digest(self, report: PeerReport) -> None:
        now_s = report.received_at_s
        silent_s = now_s - self._reported_s
        if max(parameters.OUTAGE_FORGET_S, self._outage_s) < silent_s < math.inf:
            self._resume(now_s, silent_s)
        self._reported_s, self._interval_s = now_s, min(LONGEST_QUIET_S, report.interval_s)
        while self._asked and self._asked[0].number < report.last_probe:
            self._asked.popleft()
        self._loss.digest(report)
        peer = self._peers.digest(report, handed_bytes=self._local.handed_bytes)
        if report.delays_s:
            self._pinged.append(peer.delay_s)
        if self._peers.is_first(report.peer):
            for train in report.trains:
                self._trains.note(train, now_s, copies=self._copies)

    def _measure_queue(self, now_s: float) -> None:
        backlog_s = self._peers.backlog_s(now_s, burst_bytes=self._burst_bytes, capacity=self._capacity)
        # While nothing arrives, lost bytes look like waiting ones.
        self._alarm_s = 0.0 if self._is_silent else max(self._local.backlog_s, backlog_s, 0.0)
        pinged_s = self._peers.delay_s(now_s, handed_bytes=self._local.handed_bytes, capacity=self._capacity)
        self._queue_delay_s = max(0.0, pinged_s, self._alarm_s)
        self._queues.note(now_s, self._queue_delay_s)

    def _forget_queue(self) -> None:
        """Forget a queue that no peer measures now; its last length must not hold the budget."""
        self._peers.forget()
        self._queue_delay_s = self._alarm_s = self._local.backlog_s
        self._queues = QueuePast()

    def _resume(self, now_s: float, silent_s: float) -> None:
        # What the outage held up is a queue still, and the pings in it show how long it is, against delays of before.
        # Where they were lost, they look the same until a later one arrives.
        self._schedule.hurry()
        self._trains.clear()
        if self._stated.kind is CapacityKind.PEER:
            self._stated.fell_at_s = now_s
            self._stated.change(now_s, f"reports resumed after {silent_s:.1f} s of silence")

    # -- the capacity

    def _learn(self, now_s: float, *, has_reports: bool) -> None:
        """Weigh what trains and deliveries show, and state what is news."""
        pinged, self._pinged = self._pinged, []
        if self._is_silent:
            return  # silence is no capacity; without a peer, `_judge_alone` learns
        seen, leap = "", self._trains.leap
        is_known = self._stated.kind is CapacityKind.PEER
        believed = self._stated.capacity if is_known else math.inf
        for rate, is_bound in self._trains.take(packet_overhead_s=self._overhead_s, believed=believed):
            if not is_bound or rate > self._stated.capacity:  # that it carries less than is believed is no news
                self._stated.belief.wait(now_s)
                (self._stated.belief.carried if is_bound else self._stated.belief.train)(rate)
            seen = f"trains see {format_rate(rate)}{' or more' * is_bound}"
        if self._trains.leap not in {None, leap}:
            self._schedule.repeat_train()
        shown = self._weigh_delivery(now_s, pinged, has_reports=has_reports)
        # Beside a queue that stands no train leaves, and what is delivered is the capacity.
        is_measured = is_known or self._trains.count >= _ENOUGH_TRAINS
        why = "; ".join(filter(None, (seen, shown)))
        if why and (is_measured or self._queues.stays_s(parameters.STANDING_S) > self._queue_low_s):
            self._stated.follow(now_s, CapacityKind.PEER, why)

    def _weigh_delivery(self, now_s: float, pinged: Sequence[float], *, has_reports: bool) -> str:
        """Weigh what arrived, or left, since the last look; return what it shows, in words."""
        believed = self._stated.belief
        late_s = 1.5 * (self._peers.return_delay_s or 0.0)
        stays = self._queues.stays_s(parameters.BUSY_AFTER_S) > parameters.BUSY_S + late_s
        # Bytes from other senders are no evidence. Beside them, what this host sent may wait in a queue that it cannot
        # see, unless a ping met none.
        received, most = self._peers.delivery()[0], self._local.could_have_arrived(self._queue_delay_s)
        delivered = min(self._peers.delivery(now_s - parameters.RECENT_S)[0] if stays else received, most)
        has_arrived = received <= parameters.OTHERS * most or self._queue_delay_s < parameters.IDLE_S
        # What leaves this host arrives at the peer: the same bytes count once.
        busy = self._local.backlog.busy_rate
        if busy is None and has_reports:
            busy = self._peers.busy_rate or (delivered if stays and has_arrived else None)
        if busy:
            believed.wait(now_s)
            believed.delivered_busy(busy, overhead=self._peers.overhead_of(busy, self._overhead_s))
            return f"{format_rate(busy)} carried, never idle"
        if not has_reports or delivered <= 0:
            return ""
        if not stays:
            return self._weigh_idleness(now_s, delivered, pinged, has_arrived=has_arrived)
        if (growth := self._queues.growth) <= -0.5:
            return ""  # a queue that drains says nothing: less is sent than the link carries
        believed.wait(now_s)
        believed.filled_by(delivered / (1.0 + growth))
        return f"{format_rate(delivered)} sent into a queue of {format_duration(self._queue_delay_s)}"

    def _weigh_idleness(self, now_s: float, delivered: float, pinged: Sequence[float], *, has_arrived: bool) -> str:
        """Weigh that so much was carried, and how often it met no queue (bytes/s, delays s); return it in words."""
        believed, overhead = self._stated.belief, self._peers.overhead_of(delivered, self._overhead_s)
        # On a link that carries little, time passes without a sign of the capacity, and the belief stays.
        if overhead + delivered / self._stated.capacity <= parameters.USED:
            return ""
        # Where the largest sample takes no longer than the jitter of pings, no queue shows in them at any load. Then to
        # carry less than is believed is no news, either: the belief would only rise with time.
        shows_queue = self._largest_s > 2.0 * parameters.IDLE_S
        carried = parameters.CAUTION * delivered if has_arrived else 0.0
        if shows_queue or carried > self._stated.capacity:
            believed.wait(now_s)
        if has_arrived:
            believed.carried(carried, overhead=overhead)
        if shows_queue and self._alarm_s <= 0.0:
            shown = 1.0 - parameters.IDLE_S / self._largest_s
            for delay_s in pinged:
                weight = parameters.PING_WEIGHT / len(self._peers)  # a ping goes to each of them
                is_idle = delay_s < parameters.IDLE_S
                believed.ping(delivered, was_idle=is_idle, weight=weight, overhead=overhead, shown=shown)
        return f"{format_rate(delivered)} carried without a queue"

    def _judge(self, now_s: float) -> LinkState:
        if self._queues.stays_s(parameters.STANDING_S) > self._queue_low_s:
            is_draining = now_s - self._stated.fell_at_s < parameters.URGENT_S
            return LinkState.DRAINING if is_draining else LinkState.CONGESTED
        busy = self._peers.delivery()[0] > 0.8 * self._settings.headroom * self._capacity
        return LinkState.STEADY if busy else LinkState.APP_LIMITED

    def _judge_alone(self, now_s: float, counters: LinkCounters | None) -> LinkState:
        """Judge without a peer: what leaves while the local queue pushes back is the capacity."""
        if counters is None or not counters.is_up:
            return LinkState.OUTAGE
        believed, sent = self._stated.belief, self._local.sent_bytes_per_second()
        busy, is_known = self._local.backlog.busy_rate, self._stated.kind is CapacityKind.LOCAL
        # Where a queue has shown the capacity, none shows that there is more.
        is_idle = is_known and counters.backlog_bytes == 0 and sent > parameters.USED * self._stated.capacity
        if busy is not None or is_idle:
            believed.wait(now_s)
            if busy is not None:
                believed.delivered_busy(busy)
            else:
                believed.ping(sent, was_idle=True, weight=parameters.LOOK_WEIGHT)
            self._stated.follow(now_s, CapacityKind.LOCAL, "the queue of this host's interface")
        return LinkState.CONGESTED if self._local.backlog_s > 0.0 else LinkState.APP_LIMITED

    @property
    def _is_pinned(self) -> bool:
        return self._settings.capacity_bytes_per_second is not None

    @property
    def _in_force(self) -> tuple[float, CapacityKind, str]:
        return self._stated.in_force(pinned=self._settings.capacity_bytes_per_second, radio=self._radio)

    @property
    def _capacity(self) -> float:
        """Capacity in force; no division by a silent radio (bytes/s)."""
        return max(1.0, self._in_force[0])

    @property
    def _outage_s(self) -> float:
        """Silence that is an outage: longer than one lost report explains, at the pace that reached the peer (s).

        Who sends no probes, because the capacity is pinned or another daemon drives, sees the pace in the reports.
        """
        quiet_s = max((request.quiet_s for request in self._asked), default=self._interval_s)
        return max(parameters.OUTAGE_S, parameters.OUTAGE_QUIETS * quiet_s)

    @property
    def _queue_low_s(self) -> float:
        return parameters.QUEUE_LOW_S + self._largest_s

    @property
    def _largest_s(self) -> float:
        """Link time of the largest sample; so much is no queue (s)."""
        return min(parameters.BURST_CAP_S, self._largest_bytes / self._capacity)

    @property
    def _burst_bytes(self) -> float:
        return max(parameters.BURST_BYTES, parameters.BURST_SHARE * self._largest_bytes)

    @property
    def _is_resting(self) -> bool:
        """True while next to nothing leaves or arrives, of topics or of others; traffic that begins ends that."""
        return self._last_s - self._used_s > parameters.RESTING_S

    @property
    def _overhead_s(self) -> float:
        pinned = self._settings.packet_overhead_s
        return self._trains.packet_overhead_s if pinned is None else pinned

    def _estimate(self, now_s: float, cross_traffic: float) -> LinkEstimate:
        capacity, kind, evidence = self._in_force
        since_s = max(self._trains.newest_s, self._started_at_s, self._stated.changed_at_s)
        is_out = self._state is LinkState.OUTAGE
        delivered = self._local.sent_bytes_per_second() if self._is_silent else self._peers.delivery()[0]
        return LinkEstimate(
            capacity_bytes_per_second=capacity,
            kind=kind,
            state=self._state,
            queue_delay_s=self._queue_delay_s,
            queue_allowance_s=self._queue_low_s,
            standing_delay_s=self._queues.stays_s(parameters.STANDING_S),
            delivery_rate_bytes_per_second=0.0 if is_out else delivered,
            is_resting=self._is_resting,
            age_s=0.0 if self._is_pinned else now_s - since_s,
            evidence=evidence,
            cross_traffic_bytes_per_second=min(cross_traffic, capacity),
            packet_overhead_s=self._overhead_s,
            # In an outage nobody knows whether unanswered probes are lost.
            loss_ratio=None if is_out else self._loss.ratio(now_s),
            return_delay_s=None if is_out else self._peers.return_delay_s,
        )
