"""The decision log: what differs between one snapshot and the next, in plain sentences."""

from __future__ import annotations

from collections import deque
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.report.event_limits import Quota
from arpd.report.events import Event, EventKind, Said, Severity
from arpd.report.log_endpoints import EndpointLog
from arpd.report.log_link import InterfaceLog, LeaderLog, LinkLog, PeerLog
from arpd.report.log_plan import FittingLog, PlanLog, WaitingLog
from arpd.report.log_rates import RatesLog
from arpd.report.situation import reload_refused
from arpd.report.snapshot import Totals
from arpd.report.wording import count, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from arpd.report.snapshot import Snapshot

MOST_EVENTS = 200  # kept
MOST_A_MINUTE = 12  # of each kind; one event then counts the rest of that minute
_MOST_DETAIL = 200  # characters


class DecisionLog:
    """Finds the events between successive snapshots, and keeps the last of them."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._counts = dict.fromkeys(map(str, EventKind), 0)
        self._quotas = {kind: Quota(MOST_A_MINUTE) for kind in EventKind}
        self._flooding: set[EventKind] = set()
        self._before: Snapshot | None = None
        self._told = 0
        self._leader, self._interface, self._link, self._peers = LeaderLog(), InterfaceLog(), LinkLog(), PeerLog()
        self._plan, self._waiting, self._fitting = PlanLog(), WaitingLog(), FittingLog()
        self._rates = RatesLog()
        self._endpoints = EndpointLog()
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
        if snapshot is self._before or snapshot == self._before:
            return ()
        said = [*self._within_quota(snapshot), *self._left_out(snapshot.finished_at_s)]
        self._before = snapshot
        if not said:
            return ()
        events = tuple(self._event(one, snapshot.unix_time_s) for one in said)
        self._events.extend(events)
        self._kept = tuple(self._events)
        self._counted = MappingProxyType(dict(self._counts))
        return events

    def _within_quota(self, snapshot: Snapshot) -> Iterator[Said]:
        for one in self._all_of(snapshot):
            if self._quotas[one.kind].take(snapshot.finished_at_s):
                yield one
            else:
                self._flooding.add(one.kind)

    def _all_of(self, snapshot: Snapshot) -> Iterator[Said]:
        if self._before is None:
            yield _started(snapshot)
        yield from self._leader.follow(snapshot)
        yield from self._interface.follow(snapshot)
        yield from self._link.follow(snapshot)
        yield from self._peers.follow(snapshot)
        yield from _reloads(self._before.totals if self._before is not None else Totals(), snapshot)
        yield from self._endpoints.follow(snapshot)
        yield from self._plan.follow(snapshot)
        yield from self._waiting.follow(snapshot, made_s=self._plan.made_s)
        yield from self._fitting.follow(snapshot)
        yield from self._rates.follow(snapshot)

    def _left_out(self, now_s: float) -> Iterator[Said]:
        for kind in sorted(self._flooding):
            if untold := self._quotas[kind].settle(now_s):
                self._flooding.discard(kind)
                what = count(untold, f"more event of the kind {kind}", f"more events of the kind {kind}")
                yield Said(kind, Severity.WARNING, f"{what} in the last minute", details={"untold": str(untold)})

    def _event(self, said: Said, unix_time_s: float) -> Event:
        self._told += 1
        self._counts[said.kind] += 1
        return Event(
            number=self._told,
            unix_time_s=unix_time_s,
            kind=said.kind,
            severity=said.severity,
            text=one_line(said.text),
            topic=said.topic,
            node=said.node,
            details=MappingProxyType({name: one_line(text, _MOST_DETAIL) for name, text in said.details.items()}),
        )


def _started(snapshot: Snapshot) -> Said:
    text = f"arpd {snapshot.version} governs {snapshot.interface}"
    details = {"version": snapshot.version, "interface": snapshot.interface, "config": snapshot.config_path}
    return Said(EventKind.STARTED, Severity.INFO, text, details=details)


def _reloads(before: Totals, now: Snapshot) -> Iterator[Said]:
    """Return the reloads that ended since; the daemon's log has every key that changed or is wrong."""
    ended, ended_before = now.totals.reloads_by_result, before.reloads_by_result
    if ended == ended_before:
        return
    if ended.get("failed", 0) > ended_before.get("failed", 0):
        refused = reload_refused(now)
        details = {"config": now.config_path}
        yield Said(EventKind.RELOAD_FAILED, refused.condition.severity, refused.phrase, details=details)
    if ended.get("ok", 0) > ended_before.get("ok", 0):
        keys, keys_before = now.totals.changed_keys_by_effect, before.changed_keys_by_effect
        changed = keys.get("in_force", 0) - keys_before.get("in_force", 0)
        waiting = f"; {count(len(now.keys_awaiting_restart), 'key')} of the file after a restart only"
        what = f"{count(changed, 'key')} changed" if changed else "nothing changed"
        yield Said(
            EventKind.RELOADED,
            Severity.INFO,
            f"reloaded: {what}" + (waiting if now.keys_awaiting_restart else ""),
            details={"changed": str(changed), "awaiting_restart": str(len(now.keys_awaiting_restart))},
        )
