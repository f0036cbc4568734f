"""Queues: what stands, what only comes and goes; that of this host's own interface, and what leaves it."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from arpd.estimate.parameters import BUSY_AFTER_S, DELIVERY_WINDOW_S

if TYPE_CHECKING:
    from arpd.model.interface import LinkCounters

_SENT_WINDOW_S, _SENT_MEMORY_S = 0.35, 3.0
_STANDING_S = 0.08
_LEAST_SPAN_S = 0.015  # a shorter one counts too few packets
_SURELY = 1.2  # times what left: counters are read one after the other
_LEAST_RATE = 0.05  # of the capacity: a queue that nothing leaves is long, and not endless
_KNOWN = 0.8  # of a span must be known


class Look(NamedTuple):
    """Bytes that wait at a time (s), and those that left since the look before."""

    at_s: float
    waiting_bytes: float
    left_bytes: float
    is_late: bool = False  # a ping should have arrived by then, so no burst explains what waits


class StandingQueue:
    """Bytes that wait before a link; the least of the recent looks stands.

    Messages of several topics that coincide come and go within a look or two.

    Parameters
    ----------
    fresh_s : looks that are older, or further apart, do not count (s)
    least_span_s : a shorter interval shows no busy rate (s)

    Attributes
    ----------
    busy_rate : capacity between the last two looks, None where the link may have idled (bytes/s)
    """

    def __init__(self, *, fresh_s: float = math.inf, least_span_s: float = _LEAST_SPAN_S) -> None:
        self._fresh_s, self._least_span_s = fresh_s, least_span_s
        self._looks: deque[Look] = deque()
        self.busy_rate: float | None = None

    def note(self, look: Look, *, interval_s: float | None = None) -> None:
        """Note a look, and in which time the bytes left; None = since the look before.

        When no more left than waited at the look before, the link was never idle between the two, and what left is its
        capacity.
        """
        self.busy_rate = None
        if self._looks:
            before = self._looks[-1]
            apart_s = look.at_s - before.at_s
            span_s = apart_s if interval_s is None else interval_s
            if min(span_s, apart_s) >= self._least_span_s and before.waiting_bytes >= _SURELY * look.left_bytes > 0:
                self.busy_rate = look.left_bytes / span_s
        self._looks.append(look)
        # Keep as many looks as separate a standing queue from a burst.
        while len(self._looks) > 1 and look.at_s - self._looks[1].at_s >= _STANDING_S:
            self._looks.popleft()

    def clear(self) -> None:
        """Forget every look."""
        self._looks.clear()
        self.busy_rate = None

    def delay_s(self, now_s: float, *, burst_bytes: float, capacity: float) -> float:
        """Return how long the waiting bytes will take to leave; 0 while a burst of messages may explain them (s).

        Parameters
        ----------
        burst_bytes : bytes that may stand without being a queue
        capacity : the one that is believed (bytes/s)
        """
        looks = self._looks
        if not looks or now_s - looks[-1].at_s > self._fresh_s:
            return 0.0
        span_s = looks[-1].at_s - looks[0].at_s
        stands = looks[-1].is_late or min(look.waiting_bytes for look in looks) > burst_bytes
        if not _STANDING_S <= span_s <= self._fresh_s or not stands or looks[-1].waiting_bytes <= burst_bytes:
            return 0.0
        rate = (sum(look.left_bytes for look in looks) - looks[0].left_bytes) / span_s
        return looks[-1].waiting_bytes / max(rate, _LEAST_RATE * capacity)


class LocalQueue:
    """Queue of this host's interface, where the kernel shows one, and what leaves it.

    Attributes
    ----------
    backlog : bytes in the queue
    handed_bytes : bytes handed to the interface so far; None = unknown
    backlog_s : queue that stood at every recent look (s)
    """

    def __init__(self) -> None:
        self.backlog = StandingQueue()
        self._sent: deque[tuple[float, int]] = deque()  # time s, sent bytes
        self.handed_bytes: float | None = None
        self.backlog_s = 0.0

    def update(self, counters: LinkCounters | None, now_s: float, *, burst_bytes: float, capacity: float) -> None:
        """Note the counters of the interface; `StandingQueue.delay_s` explains the other arguments."""
        if counters is None or not counters.is_up:
            self.backlog.clear()
            self._sent.clear()
            self.handed_bytes, self.backlog_s = None, 0.0
            return
        left_bytes = counters.tx_bytes - self._sent[-1][1] if self._sent else 0
        self._sent.append((now_s, counters.tx_bytes))
        while now_s - self._sent[0][0] > _SENT_MEMORY_S:
            self._sent.popleft()
        backlog = counters.backlog_bytes or 0
        self.handed_bytes = counters.tx_bytes + backlog
        self.backlog.note(Look(now_s, backlog, left_bytes))
        self.backlog_s = self.backlog.delay_s(now_s, burst_bytes=burst_bytes, capacity=capacity)

    def sent_bytes_per_second(self, span_s: float = _SENT_WINDOW_S) -> float:
        """Return the rate at which bytes left the interface lately, 0 while unknown (bytes/s)."""
        if not self._sent:
            return 0.0
        now_s, sent = self._sent[-1]
        later_s, later = now_s, sent
        for at_s, before in reversed(self._sent):
            if now_s - at_s >= span_s:  # looks come at uneven times, so the beginning of the span lies between two
                part = (now_s - span_s - at_s) / (later_s - at_s)
                return (sent - before - part * (later - before)) / span_s
            later_s, later = at_s, before
        return (sent - later) / (now_s - later_s) if now_s - later_s > 0.5 * span_s else 0.0

    def could_have_arrived(self, queue_s: float) -> float:
        """Return what can have arrived of this host's bytes lately: what left it, and waited beyond it (bytes/s).

        Parameters
        ----------
        queue_s : queue of the link (s)
        """
        if self.handed_bytes is None:
            return math.inf
        span_s = DELIVERY_WINDOW_S + min(_SENT_MEMORY_S - 1.0, queue_s)
        return self.sent_bytes_per_second(span_s) * span_s / DELIVERY_WINDOW_S


class QueuePast:
    """Lengths of the queue, as far back as proves a busy link."""

    def __init__(self) -> None:
        self._queues: deque[tuple[float, float]] = deque()  # time s, queue s

    def note(self, now_s: float, queue_s: float) -> None:
        """Note the queue now (s)."""
        self._queues.append((now_s, queue_s))
        while len(self._queues) > 1 and now_s - self._queues[1][0] >= BUSY_AFTER_S:
            self._queues.popleft()

    def stays_s(self, span_s: float) -> float:
        """Return the shortest queue of a span: bursts come and go, and a queue that stays means a busy link (s)."""
        if not self._queues or self._queues[-1][0] - self._queues[0][0] < _KNOWN * span_s:
            return 0.0
        since_s = self._queues[-1][0] - span_s
        return min(queue_s for at_s, queue_s in self._queues if at_s >= since_s)

    @property
    def growth(self) -> float:
        """How fast the queue grew lately (s/s)."""
        (before_s, before), (now_s, now) = self._queues[0], self._queues[-1]
        return (now - before) / (now_s - before_s) if now_s > before_s else 0.0
