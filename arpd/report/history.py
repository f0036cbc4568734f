"""The last ten minutes of the link for charts, one sample a second."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.model.link import LinkState
    from arpd.report.snapshot import Snapshot

SPAN_S = 600.0
PERIOD_S = 1.0
_EARLY_S = 0.05  # half a tick: the tick nearest to the full period takes the sample

# What each sample holds of the link, by its name in the API.
LINK_SERIES: dict[str, Callable[[Snapshot], float]] = {
    "capacity_bytes_per_second": lambda s: s.link.capacity_bytes_per_second,
    "available_bytes_per_second": lambda s: s.link.available_bytes_per_second,
    "budget_bytes_per_second": lambda s: s.allocation.budget_bytes_per_second,
    "level_bytes_per_second": lambda s: s.decision.plan.level_bytes_per_second,
    "delivery_rate_bytes_per_second": lambda s: s.link.delivery_rate_bytes_per_second,
    "cross_traffic_bytes_per_second": lambda s: s.link.cross_traffic_bytes_per_second,
    "queue_delay_s": lambda s: s.link.queue_delay_s,
    "loss_ratio": lambda s: math.nan if s.link.loss_ratio is None else s.link.loss_ratio,
    "allowed_ratio": lambda s: s.decision.allowed,
}


class Sample(NamedTuple):
    """One moment by the monotonic and the wall clock (s): the link's state, and `LINK_SERIES`, NaN where not known."""

    at_s: float
    unix_time_s: float
    state: LinkState
    link: tuple[float, ...]


class History:
    """Samples snapshots; written by the tick, read by the HTTP server's thread.

    A sample is immutable, and the tick appends it in one step, so readers need no lock and never delay a tick.
    """

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque(maxlen=round(SPAN_S / PERIOD_S))
        self._due_s = -math.inf

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The samples so far, oldest first."""
        return tuple(self._samples)

    def note(self, snapshot: Snapshot) -> None:
        """Take a sample of the snapshot if one is due."""
        now_s = snapshot.finished_at_s
        if now_s < self._due_s - _EARLY_S:
            return
        is_late = now_s - self._due_s >= PERIOD_S
        self._due_s = (now_s if is_late else self._due_s) + PERIOD_S
        link = tuple(read(snapshot) for read in LINK_SERIES.values())
        self._samples.append(Sample(now_s, snapshot.unix_time_s, snapshot.link.state, link))
