"""The lease of a plan: the time for which it outlives the last sign of its daemon."""

from __future__ import annotations

import math


class Lease:
    """Time since the last sign of the daemon, against the time it granted; pure, in seconds of one monotonic clock."""

    def __init__(self) -> None:
        self.granted_s = 0.0
        self._heard_at_s = -math.inf

    def renew(self, now_s: float) -> None:
        """Note a sign of the daemon."""
        self._heard_at_s = max(self._heard_at_s, now_s)

    def is_silent(self, now_s: float, *, for_s: float) -> bool:
        """Return whether the last sign is older than ``for_s``, or there was none."""
        return now_s - self._heard_at_s > for_s

    def is_over(self, now_s: float) -> bool:
        """Return whether the lease has run out; a grant of 0 never does."""
        return self.granted_s > 0 and self.is_silent(now_s, for_s=self.granted_s)
