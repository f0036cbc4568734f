"""The last ten minutes for charts, one sample a second, bounded at any number of topics."""

from __future__ import annotations

import math
from array import array
from collections import deque
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.quantities import shortened

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping
    from collections.abc import Set as AbstractSet

    from arpd.model.endpoints import PublisherState
    from arpd.model.link import LinkState
    from arpd.model.plan import TopicPlan
    from arpd.report.snapshot import Snapshot

SPAN_S = 600.0
PERIOD_S = 1.0
MOST_TOPICS = 200
_EARLY_S = 0.05  # half a tick: the tick nearest to the full period takes the sample


class TopicId(NamedTuple):
    """Identity of one publisher."""

    topic: str
    node: str


# What each sample holds of the link, by its name in the API.
LINK_SERIES: dict[str, Callable[[Snapshot], float]] = {
    "capacity_bytes_per_second": lambda s: s.link.capacity_bytes_per_second,
    "available_bytes_per_second": lambda s: s.link.available_bytes_per_second,
    "budget_bytes_per_second": lambda s: s.allocation.capacity_bytes_per_second,
    "level_bytes_per_second": lambda s: s.decision.plan.level_bytes_per_second,
    "delivery_rate_bytes_per_second": lambda s: s.link.delivery_rate_bytes_per_second,
    "cross_traffic_bytes_per_second": lambda s: s.link.cross_traffic_bytes_per_second,
    "queue_delay_s": lambda s: s.link.queue_delay_s,
    "loss_ratio": lambda s: math.nan if s.link.loss_ratio is None else s.link.loss_ratio,
    "allowed_ratio": lambda s: s.decision.allowed,
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """One moment; it never changes.

    Parameters
    ----------
    at_s : monotonic clock (s)
    unix_time_s : wall clock at the same moment (s)
    state : `arpd.model.link.LinkState`
    link : value of each of `LINK_SERIES`, NaN where it was not known
    slots : slot of each publisher in the rates
    rates_hz : ceiling, published, source and paced rate of each slot, NaN = not planned, ``inf`` = unpaced (Hz)
    omitted : live publishers without a slot
    """

    at_s: float
    unix_time_s: float
    state: LinkState
    link: tuple[float, ...]
    slots: Mapping[TopicId, int]
    rates_hz: array[float]
    omitted: int


RATE_SERIES = ("planned_rate_hz", "published_rate_hz", "source_rate_hz", "paced_rate_hz")
NO_RATES = (math.nan,) * len(RATE_SERIES)


class History:
    """Samples snapshots; written by the tick, read by the HTTP server's threads.

    A sample is immutable, and the tick appends it in one step, so readers need no lock and never delay a tick. With all
    slots taken the whole span is 4.5 MB.
    """

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque(maxlen=round(SPAN_S / PERIOD_S))
        self._slots: Mapping[TopicId, int] = MappingProxyType({})
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
        publishers = {TopicId(p.topic, p.node): p for p in snapshot.observation.publishers}
        plan = snapshot.decision.plan.topics
        self._give_slots(publishers.keys(), plan)
        values = array("d")
        for identity in self._slots:
            values.extend(_rates(publishers[identity], plan.get(identity.topic)))
        self._samples.append(
            Sample(
                at_s=now_s,
                unix_time_s=snapshot.unix_time_s,
                state=snapshot.link.state,
                link=tuple(read(snapshot) for read in LINK_SERIES.values()),
                slots=self._slots,
                rates_hz=values,
                omitted=len(publishers) - len(self._slots),
            )
        )

    def _give_slots(self, live: AbstractSet[TopicId], planned: Container[str]) -> None:
        """Give the publishers slots: those that have one first, then planned ones; the same again where all stay."""
        kept = [identity for identity in self._slots if identity in live]
        new = sorted(live - self._slots.keys(), key=lambda identity: (identity.topic not in planned, identity))
        given = [*kept, *new][:MOST_TOPICS]
        if given != [*self._slots]:
            self._slots = MappingProxyType({identity: slot for slot, identity in enumerate(given)})


def _rates(publisher: PublisherState, planned: TopicPlan | None) -> tuple[float, ...]:
    return (
        math.nan if planned is None else shortened(planned.rate_hz),
        shortened(publisher.published_rate_hz),
        shortened(publisher.source_rate_hz),
        shortened(publisher.paced_rate_hz),
    )
