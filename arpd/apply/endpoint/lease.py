"""How long settings stay in force when nobody is heard of who keeps them up to date."""

from __future__ import annotations

import math


class Lease:
    """Time since the daemon was last heard of, against what it granted; pure, in seconds of one monotonic clock."""

    def __init__(self) -> None:
        self.granted_s = 0.0
        self._heard_at_s = -math.inf

    def renew(self, now_s: float) -> None:
        """Note a sign of life."""
        self._heard_at_s = max(self._heard_at_s, now_s)

    def is_silent(self, now_s: float, *, for_s: float) -> bool:
        """Whether the last sign of life is older than ``for_s``, or there was none."""
        return now_s - self._heard_at_s > for_s

    def is_over(self, now_s: float) -> bool:
        """Whether the settings have outlived what was granted; a grant of 0 never ends."""
        return self.granted_s > 0 and self.is_silent(now_s, for_s=self.granted_s)
