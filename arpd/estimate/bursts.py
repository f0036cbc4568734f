"""Bursts: what may stand before the link without being a queue."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.estimate import parameters
from arpd.model.endpoints import Direction
from arpd.model.wire import wire_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.endpoints import PublisherState


class Bursts:
    """Sizes of the largest sample, and of a probe train that has just left.

    Attributes
    ----------
    backlog_bytes : bytes that may wait without being a queue
    largest_s : link time of the largest sample; so much is no queue (s)
    """

    def __init__(self) -> None:
        self.backlog_bytes = 0.0
        self.largest_s = 0.0
        self._publishers: Sequence[PublisherState] | None = None  # whose largest sample is known
        self._largest_bytes = 0.0  # on the link, in all its copies
        self._train: tuple[float, float] = (-math.inf, 0.0)  # the last one: departure s, bytes on the link

    def note_train(self, now_s: float, wire_bytes: float) -> None:
        """Note a train that leaves, with its bytes in all copies."""
        self._train = now_s, wire_bytes

    def train_rate(self, now_s: float) -> float:
        """Return what the last train adds to the rates that counters and reports show now (bytes/s)."""
        departed_s, wire_bytes = self._train
        return wire_bytes / parameters.DELIVERY_WINDOW_S if now_s - departed_s < parameters.TRAIN_SHOWS_S else 0.0

    def update(self, publishers: Sequence[PublisherState], now_s: float, *, capacity: float) -> None:
        """Take in the publishers of a tick, and the capacity that is believed (bytes/s)."""
        if publishers is not self._publishers:
            self._publishers = publishers
            sizes = (
                publisher.copies * wire_size(publisher.payload_bytes, rate_hz=math.inf)[0]
                for publisher in publishers
                if publisher.payload_bytes > 0 and publisher.direction is not Direction.LOCAL
            )
            self._largest_bytes = max(sizes, default=0.0)
        train_bytes = self._train[1] if now_s - self._train[0] < parameters.TRAIN_IS_NEAR_S else 0.0
        self.backlog_bytes = max(parameters.BURST_BYTES, parameters.BURST_SHARE * self._largest_bytes) + train_bytes
        self.largest_s = min(parameters.BURST_CAP_S, self._largest_bytes / capacity)
