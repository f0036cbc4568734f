"""Patience: a rise waits longer each time that a fall soon follows one."""

from __future__ import annotations

import math

_MOST = 16
_RELAPSE_S = 120.0  # after a fall so soon after a rise, the next rise waits longer


class Patience:
    """How much longer than at first a change for the better must last.

    Attributes
    ----------
    factor : 1 at first, doubled with each relapse up to 16
    fell_s, rose_s : times of the last fall and of the last rise (s)
    """

    def __init__(self) -> None:
        self.factor = 1
        self.fell_s = self.rose_s = -math.inf

    def note_fall(self, now_s: float) -> None:
        """Note a change for the worse; the first of several after a rise counts."""
        if self.rose_s > self.fell_s:
            has_relapsed = now_s - self.rose_s < _RELAPSE_S
            self.factor = min(2 * self.factor, _MOST) if has_relapsed else 1
        self.fell_s = now_s

    def note_rise(self, now_s: float) -> None:
        """Note a change for the better."""
        self.rose_s = now_s
