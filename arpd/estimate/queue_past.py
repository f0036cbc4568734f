"""Queue of the link over the last moments: how long it stays, and how fast it grows."""

from __future__ import annotations

from collections import deque

_MOST = 0.8  # of a span must be known


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
        if not self._queues or self._queues[-1][0] - self._queues[0][0] < _MOST * span_s:
            return 0.0
        since_s = self._queues[-1][0] - span_s
        return min(queue_s for at_s, queue_s in self._queues if at_s >= since_s)

    @property
    def growth(self) -> float:
        """How fast the queue grew lately (s/s)."""
        (before_s, before), (now_s, now) = self._queues[0], self._queues[-1]
        return (now - before) / (now_s - before_s) if now_s > before_s else 0.0
