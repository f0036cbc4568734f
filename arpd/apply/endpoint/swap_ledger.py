"""What the swaps of one publisher took: time by phase, in all and of the one that ended last."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

from arpd.model.endpoints import SwapRecord

if TYPE_CHECKING:
    from arpd.model.endpoints import SwapPhase, SwapResult, WriterQos


class SwapLedger:
    """Keeps the time of swaps, one after another.

    A phase is charged when it ends, draining when the old writer goes. Of a swap, the phases last from its begin to
    its result; so draining comes after its record, and is in ``seconds_by_phase`` only.

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
        """Begin a swap; its first phase comes next, or its result."""
        self.begun += 1
        self._seconds = defaultdict(float)
        self._phase = None

    def enter(self, phase: SwapPhase, now_s: float) -> None:
        """Charge the phase that ends, and begin the next."""
        self._charge(now_s)
        self._phase = phase

    def finish(self, result: SwapResult, qos: WriterQos, now_s: float) -> None:
        """Charge the last phase, and record the swap."""
        self._charge(now_s)
        self._phase = None
        self.last = SwapRecord(
            number=self.begun,
            result=result.value,
            depth=qos.depth,
            deadline_ns=qos.deadline_ns,
            seconds_by_phase=dict(self._seconds),
        )

    def drain(self, phase: SwapPhase, seconds: float) -> None:
        """Charge what an old writer took to go, beside whatever swap is under way by then."""
        self.seconds_by_phase[phase.value] += max(0.0, seconds)

    def _charge(self, now_s: float) -> None:
        # Two threads look at the clock before they take their turn, and the later one may come first.
        seconds = now_s - self._at_s
        if seconds <= 0:
            return
        self._at_s = now_s
        if self._phase is not None:
            self._seconds[self._phase.value] += seconds
            self.seconds_by_phase[self._phase.value] += seconds
