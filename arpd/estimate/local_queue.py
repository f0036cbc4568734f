"""Queues: what stands, what only comes and goes; that of this host's own interface, and what leaves it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.estimate.parameters import DELIVERY_WINDOW_S, LOCAL_WINDOW_S, QUEUED_HERE_S
from arpd.model.endpoints import Direction

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.interface import LinkCounters
    from arpd.model.observation import Observation

_BLOCKED_SHARE = 0.2  # of the time: publishers waited for so long for room in the socket
_SENT_WINDOW_S = 0.35
_SENT_MEMORY_S = 3.0
_ANNOUNCED_S = 1.0  # most age of an announced waiting time


@dataclass(frozen=True, kw_only=True, slots=True)
class _Look:
    at_s: float
    sent_bytes: int
    blocked_s: Mapping[tuple[str, str], float]  # by node and topic


class LocalQueue:
    """Queue of this host's interface, where the kernel shows one, and what leaves while it stands."""

    def __init__(self) -> None:
        self._backlog = StandingQueue()
        self._since: _Look | None = None
        self._sent: deque[tuple[float, int]] = deque()  # time s, sent bytes
        self._waited_s = -math.inf  # when it was last seen that the interface is never idle
        self.is_where_it_waits = False  # whether a queue was seen here lately, so it is the one of the link
        self.handed_bytes: float | None = None
        self.backlog_s = 0.0  # more when the queue stood at every recent look, so the interface was never idle
        self.is_empty = False

    @property
    def busy_rate(self) -> float | None:
        """Capacity between the last two looks, None where the interface may have idled (bytes/s)."""
        return self._backlog.busy_rate

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
        queue_s : queue of the link; before this interface it holds what has not left (s)
        """
        if self.handed_bytes is None:
            return math.inf
        span_s = DELIVERY_WINDOW_S + (0.0 if self.is_where_it_waits else min(_SENT_MEMORY_S - 1.0, queue_s))
        return self.sent_bytes_per_second(span_s) * span_s / DELIVERY_WINDOW_S

    def update(self, counters: LinkCounters | None, now_s: float, *, burst_bytes: float, capacity: float) -> None:
        """Note the counters of the interface; `StandingQueue.delay_s` explains the other arguments."""
        self.handed_bytes, self.backlog_s, self.is_empty = None, 0.0, False
        self.is_where_it_waits = now_s - self._waited_s < QUEUED_HERE_S
        if counters is None or not counters.is_up:
            self._backlog.clear()
            self._sent.clear()
            return
        left_bytes = counters.tx_bytes - self._sent[-1][1] if self._sent else 0
        self._sent.append((now_s, counters.tx_bytes))
        while now_s - self._sent[0][0] > _SENT_MEMORY_S:
            self._sent.popleft()
        backlog = counters.backlog_bytes or 0
        self.is_empty = counters.backlog_bytes == 0
        self.handed_bytes = counters.tx_bytes + backlog
        self._backlog.note(now_s, waiting_bytes=backlog, left_bytes=left_bytes)
        if self._backlog.busy_rate is not None:
            self._waited_s, self.is_where_it_waits = now_s, True
        self.backlog_s = self._backlog.delay_s(now_s, burst_bytes=burst_bytes, capacity=capacity)

    def blocked_rate(self, observation: Observation) -> float | None:
        """Return what left while publishers waited for room, once per window; None when they did not (bytes/s).

        A dropped packet alone shows nothing: an idle link has bad moments.
        """
        if observation.counters is None:
            self._since = None
            return None
        now_s, sent_bytes, since = observation.now_s, observation.counters.tx_bytes, self._since
        span_s = math.inf if since is None else now_s - since.at_s
        if span_s < LOCAL_WINDOW_S:
            return None
        look = self._since = _Look(
            at_s=now_s,
            sent_bytes=sent_bytes,
            # Publishers on other hosts wait for their own interfaces.
            blocked_s={
                (publisher.node, publisher.topic): publisher.blocked_s
                for publisher in observation.publishers
                if publisher.direction is Direction.SENSING
            },
        )
        # Longer than two windows ago a peer measured, or the interface was down, so the look does not count.
        if since is None or span_s > 2.0 * LOCAL_WINDOW_S:
            return None
        sent = sent_bytes - since.sent_bytes
        return sent / span_s if sent > 0 and _waited_s(since, look) > _BLOCKED_SHARE * span_s else None


def _waited_s(since: _Look, look: _Look) -> float:
    """Return how long publishers waited between two looks; a longer announced wait began earlier (s)."""
    most_s = look.at_s - since.at_s + _ANNOUNCED_S
    waited = (blocked_s - since.blocked_s[who] for who, blocked_s in look.blocked_s.items() if who in since.blocked_s)
    return sum(each for each in waited if 0.0 < each <= most_s)


_STANDING_S = 0.08
_LEAST_SPAN_S = 0.015  # a shorter one counts too few packets
_SURELY = 1.2  # times what left: counters are read one after the other
_LEAST_RATE = 0.05  # of the capacity: a queue that nothing leaves is long, and not endless


@dataclass(frozen=True, slots=True)
class _Waiting:
    at_s: float
    waiting_bytes: float
    left_bytes: float


class StandingQueue:
    """Bytes that wait before a link; the least of the recent looks stands.

    Messages of several topics that coincide come and go within a look or two.

    Parameters
    ----------
    fresh_s : looks that are older, or further apart, do not count (s)
    least_span_s : a shorter interval shows no busy rate (s)
    """

    def __init__(self, *, fresh_s: float = math.inf, least_span_s: float = _LEAST_SPAN_S) -> None:
        self._fresh_s, self._least_span_s = fresh_s, least_span_s
        self._looks: deque[_Waiting] = deque()
        self.busy_rate: float | None = None  # bytes/s between the last two looks, None where the link may have idled

    def note(self, now_s: float, *, waiting_bytes: float, left_bytes: float, interval_s: float | None = None) -> None:
        """Note the bytes that wait, and those that left since the look before, or in the interval.

        When no more left than waited at the look before, the link was never idle between the two, and what left is its
        capacity.
        """
        self.busy_rate = None
        if self._looks:
            before = self._looks[-1]
            apart_s = now_s - before.at_s
            span_s = apart_s if interval_s is None else interval_s
            if min(span_s, apart_s) >= self._least_span_s and before.waiting_bytes >= _SURELY * left_bytes > 0:
                self.busy_rate = left_bytes / span_s
        self._looks.append(_Waiting(now_s, waiting_bytes, left_bytes))
        # Keep as many looks as separate a standing queue from a burst.
        while len(self._looks) > 1 and now_s - self._looks[1].at_s >= _STANDING_S:
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
        if not _STANDING_S <= span_s <= self._fresh_s or min(look.waiting_bytes for look in looks) <= burst_bytes:
            return 0.0
        rate = (sum(look.left_bytes for look in looks) - looks[0].left_bytes) / span_s
        return looks[-1].waiting_bytes / max(rate, _LEAST_RATE * capacity)


_KNOWN = 0.8  # of a span must be known


class QueuePast:
    """Lengths of the queue, as far back as makes a queue stand.

    Parameters
    ----------
    span_s : time that it covers (s)
    """

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._queues: deque[tuple[float, float]] = deque()  # time s, queue s

    def note(self, now_s: float, queue_s: float) -> None:
        """Note the queue now (s)."""
        self._queues.append((now_s, queue_s))
        while len(self._queues) > 1 and now_s - self._queues[1][0] >= self._span_s:
            self._queues.popleft()

    def clear(self) -> None:
        """Forget all."""
        self._queues.clear()

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
