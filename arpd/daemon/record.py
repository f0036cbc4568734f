"""The record of a daemon: its counts, decision log and history, and the snapshot that shows them all."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.report.decision_log import DecisionLog
from arpd.report.history import History
from arpd.report.situation import find
from arpd.report.snapshot import Totals

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.daemon.reload import Configuration
    from arpd.daemon.world import World
    from arpd.govern.governor import Governor
    from arpd.report.conditions import Finding
    from arpd.report.events import Event
    from arpd.report.snapshot import Snapshot
    from arpd.solve.program import Program

log = logging.getLogger(__name__)
_LATE_S = 0.05  # half a period
_MOST_LATE = 1000  # beginnings of ticks that are not counted yet


class Record:
    """Keeps the results of the daemon's ticks.

    Parameters
    ----------
    tell : called with each event of the decision log

    Attributes
    ----------
    snapshot : the daemon after its last finished tick, None before the first
    totals, events, found : as of the last tick that planned
    counted : number of such ticks
    history : the last ten minutes
    """

    def __init__(self, *, tell: Callable[[Event], None]) -> None:
        self.snapshot: Snapshot | None = None
        self.totals = Totals()
        self.events: tuple[Event, ...] = ()
        self.found: tuple[Finding, ...] = ()
        self.counted = 0
        self.history = History()
        self._tell = tell
        self._decision_log = DecisionLog()
        self._has_failed = False  # whether the decision log raised
        self._ticks_s: list[float] = []  # durations of the ticks that are not counted yet (s)
        self._late_s: deque[float] = deque(maxlen=_MOST_LATE)  # how late such ticks began (s)
        self._reports = 0

    def note_failed_tick(self) -> None:
        """Count a tick that raised, and show it at once: no tick may finish for a while."""
        self.totals = replace(self.totals, ticks_failed=self.totals.ticks_failed + 1)
        if self.snapshot is not None:
            totals = replace(self.snapshot.totals, ticks_failed=self.totals.ticks_failed)
            self.snapshot = replace(self.snapshot, totals=totals)

    def note_lateness(self, late_s: float) -> None:
        """Note how late a tick begins (s)."""
        self._late_s.append(late_s)

    def note(self, snapshot: Snapshot) -> None:
        """Publish the snapshot of a tick."""
        self._ticks_s.append(snapshot.tick_s)
        self._reports += len(snapshot.observation.reports)
        self.snapshot = snapshot

    def count(self, *, world: World, program: Program, governor: Governor, configuration: Configuration) -> None:
        """Count the ticks up to one that planned, and add its events to the decision log."""
        if (picture := self.snapshot) is None:
            return
        probes, probe_bytes = world.probes_sent()
        ticks_s, self._ticks_s = self._ticks_s, []
        late_s = [self._late_s.popleft() for _ in range(len(self._late_s))]
        self.totals = replace(
            self.totals,
            ticks=self.totals.ticks + len(ticks_s),
            ticks_late=self.totals.ticks_late + sum(each_s > _LATE_S for each_s in late_s),
            solves_by_outcome=MappingProxyType(dict(program.outcomes)),
            cross_check_disagreements=sum(count for (_, how), count in program.outcomes.items() if how == "disagreed"),
            plans_by_cause=MappingProxyType(dict(governor.plans_by_cause)),
            refusals_by_reason=MappingProxyType(dict(governor.refusals_by_reason)),
            applies_by_result=MappingProxyType(dict(world.results())),
            probes=probes,
            probe_bytes=probe_bytes,
            reports=self.totals.reports + self._reports,
            reloads_by_result=MappingProxyType(dict(configuration.reloads_by_result)),
            changed_keys_by_effect=MappingProxyType(dict(configuration.changed_keys_by_effect)),
            durations=self.totals.durations.including(
                ticks_s, late_s, [picture.allocation.solve_s] if picture.allocation.topics else []
            ),
        )
        self._reports = 0
        picture = replace(picture, totals=self.totals)
        self.found = find(picture)
        picture = replace(picture, found=self.found)
        try:
            for event in self._decision_log.follow(picture):
                self._tell(event)
        except Exception:
            # A fault in the log must not stop the daemon.
            if not self._has_failed:
                log.exception("the decision log failed and misses events; not logged again")
            self._has_failed = True
        self.events = self._decision_log.events
        self.totals = replace(self.totals, events_by_kind=self._decision_log.counts_by_kind)
        self.snapshot = replace(picture, totals=self.totals, events=self.events)
        self.counted += 1
        self.history.note(self.snapshot)
