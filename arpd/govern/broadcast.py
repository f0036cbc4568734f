"""When the price of the link is sent: when it changed, and again and again for those who missed it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.model.price import Price

_REPEAT_S = 1.0  # the message is best effort, and a sign that the daemon lives
_TOLERANCE = 0.01
_URGENT = 0.1  # a fall by more waits for nothing, and a rise no longer than the link needs
_MESSAGE_BYTES = 210.0
# Parts of the link for the messages to nodes beyond it: as little as keeps the pause short, and never more.
_SHARE, _USUAL_PAUSE_S, _MOST_SHARE = 0.0025, 0.1, 0.02


class Broadcast:
    """Decides at every tick whether the price goes out."""

    def __init__(self) -> None:
        self._sent: Price | None = None
        self._sent_s = -math.inf

    def is_due(self, price: Price, now_s: float) -> bool:
        """Return whether to send this price now; then it counts as sent."""
        since_s = now_s - self._sent_s
        if self._sent is not None and since_s < _REPEAT_S:
            if price.is_near(self._sent, tolerance=_TOLERANCE):
                return False
            message_s = _MESSAGE_BYTES / price.capacity_bytes_per_second
            level, before = _level(price), _level(self._sent)
            # Beside a capacity that falls, a price rises with a queue that drained for a moment.
            has_fallen = price.capacity_bytes_per_second < self._sent.capacity_bytes_per_second
            leaps = level > (1.0 + _URGENT) * before and not has_fallen
            usual_s = 0.0 if leaps else min(_USUAL_PAUSE_S, message_s / _SHARE)
            if since_s < max(usual_s, message_s / _MOST_SHARE) and level >= (1.0 - _URGENT) * before:
                return False
        self._sent, self._sent_s = price, now_s
        return True


def _level(price: Price) -> float:
    """Return ν·C, from which rates follow (bytes/s)."""
    return price.share_per_weight * price.capacity_bytes_per_second
