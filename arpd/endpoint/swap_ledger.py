"""Time that the swaps of one publisher took, by phase: of all together, and of the last one."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

from arpd.model.endpoints import SwapRecord

if TYPE_CHECKING:
    from arpd.model.endpoints import SwapPhase, SwapResult, WriterQos


class SwapLedger:
    """Adds up the time of swaps.

    A phase counts when it ends, draining when the old writer is destroyed. A swap ends before its old writer has
    drained, so draining is in ``seconds_by_phase`` only, and in no record.

    Attributes
    ----------
    begun : swaps so far, finished or not
    seconds_by_phase : time of all swaps (s)
    last : the swap that finished last, None before the first
    """

    def __init__(self) -> None:
        self.begun = 0
        self.seconds_by_phase: defaultdict[str, float] = defaultdict(float)
        self.last: SwapRecord | None = None
        self._seconds: defaultdict[str, float] = defaultdict(float)  # of the swap under way
        self._phase: SwapPhase | None = None
        self._at_s = -math.inf

    def begin(self) -> None:
        """Begin a swap; `enter` or `finish` comes next."""
        self.begun += 1
        self._seconds = defaultdict(float)

    def enter(self, phase: SwapPhase | None, now_s: float) -> None:
        """Count the phase that ends, and begin the next; None = there is none."""
        # Two threads read the clock before they take the lock, so a later time may arrive first.
        seconds = max(0.0, now_s - self._at_s)
        if self._phase is not None:
            self._seconds[self._phase.value] += seconds
            self.seconds_by_phase[self._phase.value] += seconds
        self._phase, self._at_s = phase, max(now_s, self._at_s)

    def finish(self, result: SwapResult, qos: WriterQos, now_s: float) -> None:
        """Count the last phase, and record the swap."""
        self.enter(None, now_s)
        self.last = SwapRecord(
            number=self.begun,
            result=result.value,
            depth=qos.depth,
            deadline_ns=qos.deadline_ns,
            seconds_by_phase=dict(self._seconds),
        )

    def drain(self, phase: SwapPhase, seconds: float) -> None:
        """Count the time an old writer took to drain; another swap may be under way."""
        self.seconds_by_phase[phase.value] += max(0.0, seconds)
