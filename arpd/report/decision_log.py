"""The decision log: conditions that begin or end, plans, swaps and rates, each in a plain sentence."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.quantities import format_duration
from arpd.report.conditions import MESSAGE_IDS, Condition, Finding, Happening, Severity
from arpd.report.events import Event
from arpd.report.log_plan import PlanLog
from arpd.report.log_rates import RatesLog
from arpd.report.log_swaps import SwapLog
from arpd.report.situation import HIDDEN_WHILE_CUT, is_cut, lasting
from arpd.report.waiting import is_reported
from arpd.report.wording import count, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from arpd.report.snapshot import Snapshot

MOST_EVENTS = 200  # kept
MOST_A_MINUTE = 12  # of each kind; one event then counts the rest of that minute
_MINUTE_S = 60.0
_MOST_DETAIL = 200  # characters


class DecisionLog:
    """Finds the events between successive snapshots, and keeps the last of them."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._counts = dict.fromkeys(MESSAGE_IDS, 0)
        self._limits: dict[Condition | Happening, _Limit] = {}
        self._logs = (ConditionLog(), PlanLog(), SwapLog(), RatesLog())
        self._number = 0
        self._kept: tuple[Event, ...] = ()
        self._counted: Mapping[str, int] = MappingProxyType(dict(self._counts))

    @property
    def events(self) -> tuple[Event, ...]:
        """The last events, oldest first."""
        return self._kept

    @property
    def counts_by_kind(self) -> Mapping[str, int]:
        """Events since the start, by kind; kinds without any count 0."""
        return self._counted

    def follow(self, snapshot: Snapshot) -> tuple[Event, ...]:
        """Take in the next snapshot and return what happened since the last one."""
        found = [_started(snapshot)] if not self._number else []
        for log in self._logs:
            found += log.follow(snapshot)
        now_s = snapshot.finished_at_s
        passed = [event for event in found if self._limits.setdefault(event.kind, _Limit()).passes(now_s)]
        passed += self._counts_of_the_rest(snapshot)
        events = tuple(self._numbered(event, snapshot) for event in passed)
        if events:
            self._events.extend(events)
            self._kept, self._counted = tuple(self._events), MappingProxyType(dict(self._counts))
        return events

    def _counts_of_the_rest(self, snapshot: Snapshot) -> Iterator[Event]:
        for kind, limit in self._limits.items():
            if not (number := limit.omitted_until(snapshot.finished_at_s)):
                continue
            text = f"{count(number, 'more event', 'more events')} of the kind {kind} in the last minute"
            if isinstance(kind, Condition):
                holds = any(finding.condition is kind for finding in lasting(snapshot))
                text += f"; now: {kind.phrase if holds else kind.ended}"
            yield Event(kind, Severity.WARNING, text, details={"omitted": str(number)})

    def _numbered(self, event: Event, snapshot: Snapshot) -> Event:
        self._number += 1
        self._counts[event.kind] += 1
        return replace(
            event,
            number=self._number,
            at_s=snapshot.finished_at_s,
            unix_time_s=snapshot.unix_time_s,
            text=one_line(event.text),
            details=MappingProxyType({name: one_line(text, _MOST_DETAIL) for name, text in event.details.items()}),
        )


class ConditionLog:
    """Begin and end of each condition: it begins once it has held for its time, and ends when it is gone."""

    def __init__(self) -> None:
        self._begun: dict[Condition, Finding] = {}

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        known = {finding.condition for finding in snapshot.found} | (HIDDEN_WHILE_CUT if is_cut(snapshot) else set())
        for condition in [each for each in self._begun if each not in known]:
            begun = self._begun.pop(condition)
            if condition is not Condition.POSTPONED:  # which the next plan ends
                yield _end(condition, snapshot.finished_at_s - begun.since_s, snapshot)
        for finding in lasting(snapshot):
            condition = finding.condition
            before = self._begun.get(condition, finding)
            if condition in self._begun and before.about == finding.about:
                continue
            self._begun[condition] = replace(finding, since_s=min(before.since_s, finding.since_s))
            yield Event(condition, condition.severity, finding.phrase, details={"state": "began"})


def _end(condition: Condition, lasted_s: float, snapshot: Snapshot) -> Event:
    ended = condition.ended
    if condition is Condition.OUTAGE and not is_reported(snapshot):
        # Nothing was measured: the sentence must not claim that the link is well.
        ended = "no outage any longer, although no peer reports: other hosts answer, or nobody is left to wait for"
    text = f"{ended}, after {format_duration(lasted_s)}"
    return Event(condition, Severity.INFO, text, details={"state": "ended", "seconds": f"{lasted_s:.3f}"})


class _Limit:
    """Lets so many events of a kind pass in any minute and counts the rest, until that count has been logged."""

    def __init__(self) -> None:
        self._passed_s: deque[float] = deque(maxlen=MOST_A_MINUTE)
        self._omitted = 0
        self._omitted_since_s = 0.0

    def passes(self, now_s: float) -> bool:
        """Return whether one more may pass now; otherwise count it."""
        if not self._omitted and not self._is_full(now_s):
            self._passed_s.append(now_s)
            return True
        if not self._omitted:
            self._omitted_since_s = now_s
        self._omitted += 1
        return False

    def omitted_until(self, now_s: float) -> int:
        """Return how many did not pass, once a minute is over and there is room to say so; 0 until then."""
        if not self._omitted or now_s - self._omitted_since_s < _MINUTE_S or self._is_full(now_s):
            return 0
        self._passed_s.append(now_s)
        omitted, self._omitted = self._omitted, 0
        return omitted

    def _is_full(self, now_s: float) -> bool:
        passed = self._passed_s
        return len(passed) == passed.maxlen and now_s - passed[0] < _MINUTE_S


def _started(snapshot: Snapshot) -> Event:
    text = f"arpd {snapshot.version} manages {snapshot.interface}"
    details = {"version": snapshot.version, "interface": snapshot.interface, "config": snapshot.config_path}
    return Event(Happening.STARTED, Severity.INFO, text, details=details)
