"""Budget: what the topics may put on the link now, and what they could count on lately."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from arpd.model.link import LinkEstimate, LinkState

if TYPE_CHECKING:
    from collections.abc import Iterable

    from arpd.model.allocation import Topic

_TARGET_S = 0.03  # a queue up to this, above what one large message explains, may stay
_DRAIN_S = 0.15  # a longer one is to be gone after about so long
_LEAST, _MOST = 0.1, 0.5  # part that goes on beside any queue, which is gone almost as soon: what the floors need
_LONG_S = 1.0  # a link with such a queue is dying, or nobody knows what it carries: then only the tenth goes on
_OUT, _OUT_HALF_S, _OUT_MOST_S = 0.05, 1.0, 10.0  # part that goes on in an outage, halved every second
_LEVEL_S, _MOVES_S = 1.0, 6.0
# Mean distance from the level of the last second, of the logarithm: noise of the estimate, and a link that never rests.
_RESTING, _RESTLESS = 0.03, 0.12
_SPENT = 0.8  # part of the reserve that such a link gets to carry; the rest bounds the queue of the next fall
_LASTING_S = 30.0
_LASTING_STEP_S = 0.5
_LASTING_SHARE = 0.1


class Budget:
    """Total rate of all topics, closed-loop on delay.

    The estimate feeds it forward: the headroom's part of what the link carries, and more on a link that never rests,
    where a fixed reserve would only be lost. A queue that stands feeds back: the total is what the link carries, less
    what drains the queue, but never less than a tenth, or what the floors need up to half: commands and an IMU cost
    little, and must not stop for the queue that a picture left. The law is that of a delay-target controller,
    C·(1 + (target − queue)/T), as in SCReAM (RFC 8298) and Copa (Arun and Balakrishnan, NSDI 2018).
    """

    def __init__(self) -> None:
        self._past: deque[tuple[float, float, float]] = deque()  # time s, what was available, packet overhead s then
        self._looked_at_s = self._carried_at_s = -math.inf
        self._level: float | None = None  # logarithm of what was available lately
        self._moves = 0.0  # mean distance from it

    def update(self, now_s: float, link: LinkEstimate, *, headroom: float, topics: Iterable[Topic] = ()) -> float:
        """Return the budget of this tick (bytes/s).

        Parameters
        ----------
        topics : rows of the program, whose floors go on beside a queue
        """
        available = link.available_bytes_per_second
        if link.state is LinkState.OUTAGE:
            # The silence may be the peer's alone, so the floors of what matters most go on for some seconds.
            out_s = now_s - self._carried_at_s
            part = _OUT * 2.0 ** (-out_s / _OUT_HALF_S) if out_s < _OUT_MOST_S else 0.0
            return part * headroom * available
        self._carried_at_s = now_s
        queue_s = max(link.standing_delay_s, link.queue_delay_s - link.queue_allowance_s)
        drained = 1.0 + (_TARGET_S - queue_s) / _DRAIN_S
        if drained < _MOST:
            floors = min(_MOST, _floors(link, topics)) if queue_s < _LONG_S else 0.0
            drained = max(_LEAST, drained, floors)
        share = headroom + (1.0 - headroom) * _SPENT * self._unrest(now_s, available)
        if not self._past or now_s - self._past[-1][0] >= _LASTING_STEP_S:
            self._past.append((now_s, available, link.available_packet_overhead_s))
            while now_s - self._past[0][0] > _LASTING_S:
                self._past.popleft()
        return available * min(share, drained)

    def _unrest(self, now_s: float, available: float) -> float:
        """Return how much the link moves, 0..1; where it never rests, the loop keeps the queue short, not a reserve."""
        elapsed_s, self._looked_at_s = max(0.0, min(1.0, now_s - self._looked_at_s)), now_s
        level = math.log(max(1.0, available))
        self._level = level if self._level is None else self._level
        self._level += -math.expm1(-elapsed_s / _LEVEL_S) * (level - self._level)
        self._moves += -math.expm1(-elapsed_s / _MOVES_S) * (abs(level - self._level) - self._moves)
        return min(1.0, max(0.0, self._moves - _RESTING) / _RESTLESS)

    @property
    def lasting(self) -> tuple[float, float]:
        """Capacity that nine tenths of the last half minute offered, before headroom, and the packet overhead then.

        Both are 0 before any link (bytes/s, s).
        """
        past = sorted((available, overhead_s) for _, available, overhead_s in self._past)
        return past[math.floor(_LASTING_SHARE * len(past))] if past else (0.0, 0.0)


def _floors(link: LinkEstimate, topics: Iterable[Topic]) -> float:
    """Return the part of what is available that all floors need; where they need too much, the lightest give way."""
    packet_s, available = link.available_packet_overhead_s, max(1.0, link.available_bytes_per_second)
    return sum(topic.min_rate_hz * (topic.packets * packet_s + topic.wire_bytes / available) for topic in topics)
