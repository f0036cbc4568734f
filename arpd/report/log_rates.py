"""Events of rates: topics that the link slows for long. Rates follow the price at every tick, and without a plan."""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean
from typing import TYPE_CHECKING

from arpd.model.link import LinkState
from arpd.report.conditions import Condition, Event, Happening
from arpd.report.situation import slowed_topics
from arpd.report.topic_rows import topic_rows
from arpd.report.wording import Change, changes, count

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from arpd.report.situation import Slowed
    from arpd.report.snapshot import Snapshot

_EVERY_S = 1.0
_LOOKS = 10  # a change that is over before so many is the price at work
_AS_BEFORE = 1.5  # a rate within this factor of the one in the last event is no news


class RatesLog:
    """Topics that the link slows, with their mean rates: an event when others are, or by another amount, for long."""

    def __init__(self) -> None:
        self._seen: deque[Mapping[str, Slowed]] = deque(maxlen=_LOOKS)
        self._due_s = -math.inf
        self._logged: Mapping[str, Slowed] = {}  # the last event

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        if snapshot.observation.active_daemon:
            self._seen.clear()
            self._logged = {}
        if snapshot.finished_at_s < self._due_s or not snapshot.allocation.topics:
            return
        if snapshot.link.state is LinkState.OUTAGE:  # it has an event of its own
            self._seen.clear()
            return
        self._due_s = snapshot.finished_at_s + _EVERY_S
        self._seen.append({slowed.topic: slowed for slowed in slowed_topics(topic_rows(snapshot))})
        if len(self._seen) < _LOOKS:
            return
        lasting = {topic: [seen[topic] for seen in self._seen] for topic in set.intersection(*map(set, self._seen))}
        # A topic that is slowed at times only stays what it was.
        stays = {topic: before for topic, before in self._logged.items() if any(topic in seen for seen in self._seen)}
        now = stays | {topic: _mean(seen) for topic, seen in lasting.items()}
        are_others = now.keys() != self._logged.keys()
        if are_others or any(all(_is_far(one, self._logged[topic]) for one in seen) for topic, seen in lasting.items()):
            yield _event(self._logged, now)
            self._logged = now
            self._seen.clear()


def _mean(seen: Sequence[Slowed]) -> Slowed:
    rate_hz = fmean(one.rate_hz for one in seen)
    return seen[-1]._replace(kept=fmean(one.kept for one in seen), rate_hz=rate_hz)


def _is_far(one: Slowed, other: Slowed) -> bool:
    return max(one.kept, other.kept) > _AS_BEFORE * min(one.kept, other.kept)


def _event(before: Mapping[str, Slowed], now: Mapping[str, Slowed]) -> Event:
    moved = []
    for topic in before.keys() | now.keys():
        source_hz = (now.get(topic) or before[topic]).source_hz
        was_hz = before[topic].rate_hz if topic in before else source_hz
        is_hz = now[topic].rate_hz if topic in now else source_hz
        moved.append(Change(topic, was_hz, is_hz, weight=abs(math.log(max(is_hz, 1e-3) / max(was_hz, 1e-3)))))
    words = changes(moved, " Hz")
    condition = Condition.LIMITED if now else Condition.CLEAR
    what = f"the link slows {count(len(now), 'topic')}" if now else "the link slows no topic any longer"
    details = {"topics_slowed": str(len(now))}
    return Event(Happening.RATES, condition.severity, f"{what}: {words}" if words else what, details=details)
