"""A link in virtual time: one FIFO bottleneck with tail drop, propagation delay and loss, and the clock it runs on."""

from __future__ import annotations

import heapq
import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from arpd.sim.schedule import RateSchedule

_MTU_FRAME_BYTES = 1514


class Timeline:
    """Virtual time: events run earliest first, those of one moment in the order they were planned.

    Parameters
    ----------
    now_s : where time starts (s)
    """

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s
        self._planned = 0
        self._events: list[tuple[float, int, Callable[[], object]]] = []

    def at(self, when_s: float, action: Callable[[], object]) -> None:
        """Plan an action; one in the past runs now."""
        self._planned += 1
        heapq.heappush(self._events, (when_s, self._planned, action))

    def every(self, period_s: float, action: Callable[[], None], *, first_s: float) -> None:
        """Plan an action for ever, without drift."""
        count = 0

        def again() -> None:
            nonlocal count
            action()
            count += 1
            self.at(first_s + count * period_s, again)

        self.at(first_s, again)

    def run_until(self, end_s: float) -> None:
        """Let everything before ``end_s`` happen."""
        events = self._events
        while events and events[0][0] < end_s:
            when_s, _, action = heapq.heappop(events)
            self.now_s = max(self.now_s, when_s)
            action()
        self.now_s = max(self.now_s, end_s)


class Alarm:
    """One action whose moment can be moved; what was planned before is forgotten.

    Parameters
    ----------
    action : runs when the moment comes
    """

    def __init__(self, timeline: Timeline, action: Callable[[], object]) -> None:
        self._timeline = timeline
        self._action = action
        self._setting = 0
        self.when_s = math.inf

    def set(self, when_s: float) -> None:
        """Move the moment; one in the past is now."""
        self._setting += 1
        self.when_s = when_s = max(when_s, self._timeline.now_s)
        self._timeline.at(when_s, partial(self._fire, self._setting))

    def _fire(self, setting: int) -> None:
        if setting == self._setting:
            self.when_s = math.inf
            self._action()


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkModel:
    """What the link is besides its rate; the queue is that of `arpd.sim.simlink`, so both links compare.

    Parameters
    ----------
    delay_s : propagation, one way (s)
    queue_bytes : queue in front of the bottleneck, tail drop (bytes)
    loss : probability that a packet is lost after it has used the link, 0..1
    outages : spans of run time in which nothing arrives in either direction (s, s)
    """

    delay_s: float = 0.002
    queue_bytes: int = 256_000
    loss: float = 0.0
    outages: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class _Crossing:
    """One datagram's span of service and what of it reaches the far interface (bytes, packets)."""

    start: float
    end: float
    received_bytes: float
    received_packets: int


class _Service:
    """How many bytes the bottleneck can have carried by a moment, and back; no event per packet is needed.

    Parameters
    ----------
    schedule : rate over run time
    origin_s : when run time starts; before it the first rate holds (s)
    """

    def __init__(self, schedule: RateSchedule, origin_s: float) -> None:
        self._starts = [origin_s + step.start_s for step in schedule.steps]
        self._rates = [step.rate_bytes_per_second for step in schedule.steps]
        spans = [end - start for start, end in pairwise(self._starts)]
        self._bytes = [0.0, *accumulate(s * r for s, r in zip(spans, self._rates, strict=False))]

    def rate_at(self, t_s: float) -> float:
        return self._rates[max(0, bisect_right(self._starts, t_s) - 1)]

    def by(self, t_s: float) -> float:
        i = max(0, bisect_right(self._starts, t_s) - 1)
        return self._bytes[i] + (t_s - self._starts[i]) * self._rates[i]

    def when(self, size: float) -> float:
        i = max(0, bisect_right(self._bytes, size) - 1)
        return self._starts[i] + (size - self._bytes[i]) / self._rates[i]


class SimulatedLink:
    """One direction of the link.

    A FIFO that is never idle while it holds something needs no event per packet: a datagram that arrives behind a
    backlog leaves when the bottleneck has served the backlog and the datagram, and that moment is known at once.

    Parameters
    ----------
    timeline : virtual time
    schedule : rate over run time
    origin_s : when run time starts (s)
    model : delay, queue, loss and outages
    random : source of the losses
    """

    def __init__(
        self, timeline: Timeline, schedule: RateSchedule, *, origin_s: float, model: LinkModel, random: Random
    ) -> None:
        self._timeline = timeline
        self._model = model
        self._random = random
        self._service = _Service(schedule, origin_s)
        self._outages = [(origin_s + start_s, origin_s + end_s) for start_s, end_s in model.outages]
        self._busy_until = self._service.by(timeline.now_s)
        self._crossings: deque[_Crossing] = deque()
        self._received_bytes = 0.0
        self._accepted_bytes = 0.0
        self.received_packets = 0
        self.sent_packets = 0
        self.dropped_packets = 0

    @property
    def backlog_bytes(self) -> float:
        """What waits in the queue or is being served (bytes)."""
        return max(0.0, self._busy_until - self._service.by(self._timeline.now_s))

    @property
    def queue_delay_s(self) -> float:
        """How long a packet sent now would wait (s)."""
        now_s = self._timeline.now_s
        return max(0.0, self._service.when(self._busy_until) - now_s) if self.backlog_bytes > 0 else 0.0

    @property
    def sent_bytes(self) -> float:
        """What has left the near interface (bytes)."""
        return self._accepted_bytes - self.backlog_bytes

    def send(self, wire_bytes: float, packets: int, deliver: Callable[[], None]) -> float:
        """Put one datagram on the link; ``deliver`` runs when its last fragment arrives, unless one is missing.

        Parameters
        ----------
        wire_bytes : bytes of all fragments, headers included (bytes)
        packets : fragments

        Returns
        -------
        When nothing of it is on the way any more, arrived or not (s).
        """
        room = self._model.queue_bytes + _MTU_FRAME_BYTES - self.backlog_bytes  # one frame is in service, not queued
        fragment = wire_bytes / packets
        accepted = packets if wire_bytes <= room else max(0, int(room // fragment))
        self.dropped_packets += packets - accepted
        if not accepted:
            return self._timeline.now_s
        start = max(self._busy_until, self._service.by(self._timeline.now_s))
        self._busy_until = end = start + accepted * fragment
        self._accepted_bytes += accepted * fragment
        self.sent_packets += accepted
        arrival_s = self._service.when(end) + self._model.delay_s
        surviving = self._survivors(accepted, arrival_s)
        self._crossings.append(
            _Crossing(start=start, end=end, received_bytes=surviving * fragment, received_packets=surviving)
        )
        if surviving == packets:
            self._timeline.at(arrival_s, deliver)
        return arrival_s

    def received_bytes(self) -> float:
        """Count what has reached the far interface, the datagram being received included in part (bytes)."""
        served = self._service.by(self._timeline.now_s - self._model.delay_s)
        while self._crossings and self._crossings[0].end <= served:
            done = self._crossings.popleft()
            self._received_bytes += done.received_bytes
            self.received_packets += done.received_packets
        if self._crossings and self._crossings[0].start < served:
            head = self._crossings[0]
            return self._received_bytes + head.received_bytes * (served - head.start) / (head.end - head.start)
        return self._received_bytes

    def _survivors(self, packets: int, arrival_s: float) -> int:
        if any(start_s <= arrival_s < end_s for start_s, end_s in self._outages):
            return 0
        if not self._model.loss:
            return packets
        return sum(self._random.random() >= self._model.loss for _ in range(packets))
