"""Idle links, and resting ones: where nothing crosses, nobody needs the capacity soon."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.estimate.parameters import RESTING, RESTING_S

if TYPE_CHECKING:
    from arpd.model.observation import Observation

_SPAN_S = 10.0
_SHARE = 0.05  # of the capacity; probes take 0.8 per cent


class IdleLink:
    """Looks every ten seconds whether the link is idle; a topic that comes ends that at once.

    Attributes
    ----------
    is_idle : True while no topic crosses and nothing else does
    is_resting : True while next to nothing leaves or arrives, of topics or of others; traffic that begins ends that
    """

    def __init__(self) -> None:
        self.is_idle = self.is_resting = False
        self._used_s = math.inf  # when more than next to nothing arrived last
        self._since_s = math.inf
        self._since_bytes = 0

    def note(self, observation: Observation, *, moved: float, capacity: float) -> None:
        """Take one observation.

        Parameters
        ----------
        moved, capacity : what this host sent or peers received lately, without trains; and what is believed (bytes/s)
        """
        counters, now_s = observation.counters, observation.now_s
        self._used_s = now_s if moved > RESTING * capacity else min(self._used_s, now_s)
        self.is_resting = now_s - self._used_s > RESTING_S
        moved_bytes = 0 if counters is None else counters.rx_bytes + counters.tx_bytes
        span_s = now_s - self._since_s
        if observation.sensing_topics + observation.actuation_topics > 0 or math.isinf(self._since_s):
            self.is_idle = False
        elif span_s < _SPAN_S:
            return
        else:
            self.is_idle = moved_bytes - self._since_bytes < _SHARE * capacity * span_s
        self._since_s, self._since_bytes = now_s, moved_bytes
