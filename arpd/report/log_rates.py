"""Events of rates: topics that the link slows for long. Rates follow the price at every tick, and without a plan."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from arpd.model.link import LinkState
from arpd.report.conditions import Condition, Event, Happening
from arpd.report.situation import slowed_topics
from arpd.report.topic_rows import Topic, topic_rows
from arpd.report.wording import Change, changes, count

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from arpd.report.snapshot import Snapshot

_EVERY_S = 1.0
_LASTS_S = 9.5  # a change that is over sooner is the price at work
_AS_BEFORE = 1.5  # a rate within this factor of the one in the last event is no news


class RatesLog:
    """Topics that the link slows: an event when for long others are, or by another amount, than in the last event."""

    def __init__(self) -> None:
        self._due_s = -math.inf
        self._news_since_s = math.inf
        self._logged: Mapping[str, Topic] = {}  # the last event

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        now_s, is_standing_by = snapshot.finished_at_s, bool(snapshot.observation.active_daemon)
        if is_standing_by:
            self._logged = {}
        if is_standing_by or snapshot.link.state is LinkState.OUTAGE:  # which has an event of its own
            self._news_since_s = math.inf
            return
        if now_s < self._due_s or not snapshot.allocation.topics:
            return
        self._due_s = now_s + _EVERY_S
        # Of several publishers of a topic the one that is slowed most counts, as in the verdict.
        rows = topic_rows(snapshot)
        now = {slowed.topic: slowed for slowed in reversed(slowed_topics(rows))}
        if now.keys() == self._logged.keys() and not any(_is_far(now[topic], self._logged[topic]) for topic in now):
            self._news_since_s = math.inf
            return
        self._news_since_s = min(self._news_since_s, now_s)
        if now_s - self._news_since_s >= _LASTS_S:
            there = {row.topic: row for row in rows if row.allocation}
            yield _event({topic: row for topic, row in self._logged.items() if topic in there}, now, there)
            self._logged, self._news_since_s = now, math.inf


def _is_far(one: Topic, other: Topic) -> bool:
    return max(one.kept_ratio, other.kept_ratio) > _AS_BEFORE * min(one.kept_ratio, other.kept_ratio)


def _event(before: Mapping[str, Topic], now: Mapping[str, Topic], there: Mapping[str, Topic]) -> Event:
    moved = []
    for topic in before.keys() | now.keys():
        was_hz = before[topic].allowed_hz if topic in before else now[topic].wanted_hz
        is_hz = now[topic].allowed_hz if topic in now else there[topic].wanted_hz
        moved.append(Change(topic, was_hz, is_hz, weight=abs(math.log(max(is_hz, 1e-3) / max(was_hz, 1e-3)))))
    words = changes(moved, " Hz")
    condition, what = Condition.LIMITED, f"the link slows {count(len(now), 'topic')}"
    if not now:
        condition, what = Condition.CLEAR, "the link slows no topic any longer"
    elif not any(change.after < change.before for change in moved):
        condition, what = Condition.CLEAR, f"the link lets {count(len(moved), 'topic')} send more"
    details = {"topics_slowed": str(len(now))}
    return Event(Happening.RATES, condition.severity, f"{what}: {words}" if words else what, details=details)
