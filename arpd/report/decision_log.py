"""The decision log: conditions that begin or end, plans, swaps and rates, each in a plain sentence."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.quantities import format_duration, printable
from arpd.model.settings import AUTO
from arpd.report.conditions import MESSAGE_IDS, Condition, Event, Finding, Happening, Severity
from arpd.report.log_plan import PlanLog
from arpd.report.log_rates import RatesLog
from arpd.report.log_swaps import SwapLog
from arpd.report.situation import HIDDEN_WHILE_CUT, is_cut, lasting
from arpd.report.wording import MOST_TEXT, count

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from arpd.report.snapshot import Snapshot

MOST_EVENTS = 200  # kept
MOST_A_MINUTE = 12  # of each kind
_MINUTE_S = 60.0
_MOST_DETAIL = 200  # characters


class DecisionLog:
    """Finds the events between successive snapshots, and keeps the last of them.

    A condition that begins once more than it may is told later, if it still holds, and its end only after its begin.
    Other events that are too many are left out, and the next one of their kind says how many.

    Attributes
    ----------
    events : the last events, oldest first
    counts_by_kind : events since the start; kinds without any count 0
    """

    def __init__(self) -> None:
        self.events: tuple[Event, ...] = ()
        self.counts_by_kind: Mapping[str, int] = MappingProxyType(dict.fromkeys(MESSAGE_IDS, 0))
        self._logs = (PlanLog(), SwapLog(), RatesLog())
        self._begun: dict[Condition, Finding] = {}
        self._passed_s: dict[str, deque[float]] = {kind: deque(maxlen=MOST_A_MINUTE) for kind in MESSAGE_IDS}
        self._left_out: Counter[str] = Counter()
        self._number = 0

    def follow(self, snapshot: Snapshot) -> tuple[Event, ...]:
        """Take in the next snapshot and return what happened since the last one."""
        found = [] if self._number else [_started(snapshot)]
        found += self._ended(snapshot)
        found += self._began(snapshot)
        for log in self._logs:
            found += filter(None, (self._limited(event, snapshot) for event in log.follow(snapshot)))
        events = tuple(self._numbered(event, snapshot) for event in found)
        if events:
            self.events = (*self.events, *events)[-MOST_EVENTS:]
            counts: Counter[str] = Counter(event.kind for event in events)
            self.counts_by_kind = MappingProxyType({k: many + counts[k] for k, many in self.counts_by_kind.items()})
        return events

    def _ended(self, snapshot: Snapshot) -> Iterator[Event]:
        known = {finding.condition for finding in snapshot.found} | (HIDDEN_WHILE_CUT if is_cut(snapshot) else set())
        for condition in [each for each in self._begun if each not in known]:
            begun = self._begun.pop(condition)
            if condition is not Condition.POSTPONED:  # which the next plan ends
                lasted_s = snapshot.finished_at_s - begun.since_s
                text = f"ended after {format_duration(lasted_s)}: {condition.phrase}"
                details = {"state": "ended", "seconds": f"{lasted_s:.3f}"}
                yield Event(condition, Severity.INFO, text, details=details)

    def _began(self, snapshot: Snapshot) -> Iterator[Event]:
        for finding in lasting(snapshot):
            condition, before = finding.condition, self._begun.get(finding.condition)
            is_new = before is None or before.about != finding.about
            if is_new and self._has_room(condition, snapshot.finished_at_s):
                since_s = min(finding.since_s, before.since_s if before else finding.since_s)
                self._begun[condition] = replace(finding, since_s=since_s)
                yield Event(condition, condition.severity, finding.phrase, details={"state": "began"})

    def _limited(self, event: Event, snapshot: Snapshot) -> Event | None:
        if not self._has_room(event.kind, snapshot.finished_at_s):
            self._left_out[event.kind] += 1
            return None
        if not (number := self._left_out.pop(event.kind, 0)):
            return event
        text = f"after {count(number, 'more event')} of the kind {event.kind}: {event.text}"
        return replace(event, text=text, details={**event.details, "omitted": str(number)})

    def _has_room(self, kind: str, now_s: float) -> bool:
        passed_s = self._passed_s[kind]
        if len(passed_s) == MOST_A_MINUTE and now_s - passed_s[0] < _MINUTE_S:
            return False
        passed_s.append(now_s)
        return True

    def _numbered(self, event: Event, snapshot: Snapshot) -> Event:
        self._number += 1
        return replace(
            event,
            number=self._number,
            at_s=snapshot.finished_at_s,
            unix_time_s=snapshot.unix_time_s,
            text=printable(event.text, longest=MOST_TEXT),
            details={name: printable(text, longest=_MOST_DETAIL) for name, text in event.details.items()},
        )


def _started(snapshot: Snapshot) -> Event:
    link = "no link yet" if snapshot.interface == AUTO else snapshot.interface
    text = f"arpd {snapshot.version} manages {link}"
    details = {"version": snapshot.version, "interface": snapshot.interface, "config": snapshot.config_path}
    return Event(Happening.STARTED, Severity.INFO, text, details=details)
