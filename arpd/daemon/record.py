"""The record of a daemon: its counts, decision log and history, and the snapshot that shows them all."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.wire import probe_wire_bytes
from arpd.report.decision_log import DecisionLog
from arpd.report.history import History
from arpd.report.situation import find
from arpd.report.snapshot import Snapshot, Totals

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.govern.governor import Governor
    from arpd.model.probing import ProbeRequest
    from arpd.report.conditions import Event, Finding
    from arpd.solve.program import Program

log = logging.getLogger(__name__)
_LATE_S = 0.05  # half a period


class Record:
    """Keeps the results of the daemon's ticks.

    Parameters
    ----------
    tell : called with each event of the decision log
    timed : called with each ``tick_duration``, ``tick_lateness`` and ``solve_duration`` (s)

    Attributes
    ----------
    snapshot : the daemon after its last finished tick, None before the first
    decision_log, totals, found : as of the last tick that planned
    counted : number of such ticks
    probe_bytes : wire bytes of all probes
    history : the last ten minutes
    """

    def __init__(self, *, tell: Callable[[Event], None], timed: Callable[[str, float], None]) -> None:
        self.snapshot: Snapshot | None = None
        self.totals = Totals()
        self.found: tuple[Finding, ...] = ()
        self.counted = 0
        self.history = History()
        self._tell, self._timed = tell, timed
        self.decision_log = DecisionLog()
        self._has_failed = False  # whether the decision log raised
        self._ticks = self._late = self._reports = self._probes = self.probe_bytes = 0

    def note_failed_tick(self) -> None:
        """Count a tick that raised, and show it at once: no tick may finish for a while."""
        self.totals = replace(self.totals, ticks_failed=self.totals.ticks_failed + 1)
        if self.snapshot is not None:
            self.snapshot = replace(self.snapshot, totals=self.totals)

    def note_lateness(self, late_s: float) -> None:
        """Note how late a tick begins (s)."""
        self._timed("tick_lateness", late_s)
        self._late += late_s > _LATE_S

    def note_probe(self, probe: ProbeRequest) -> None:
        """Count a probe that leaves."""
        self._probes += 1
        self.probe_bytes += probe.packets * probe_wire_bytes(probe.packet_bytes)

    def note(self, snapshot: Snapshot) -> None:
        """Publish the snapshot of a tick."""
        self._timed("tick_duration", snapshot.tick_s)
        self._ticks += 1
        self._reports += len(snapshot.observation.reports)
        self.snapshot = snapshot

    def count(self, snapshot: Snapshot, *, program: Program, governor: Governor) -> None:
        """Count the ticks up to one that planned, and add its events to the decision log."""
        if snapshot.allocation.topics:
            self._timed("solve_duration", snapshot.allocation.solve_s)
        self.totals = replace(
            self.totals,
            ticks=self._ticks,
            ticks_late=self._late,
            solves_by_outcome=MappingProxyType(dict(program.outcomes)),
            plans_by_cause=MappingProxyType(dict(governor.plans_by_cause)),
            applies_by_result=MappingProxyType(dict(snapshot.observation.answers)),
            probes=self._probes,
            probe_bytes=self.probe_bytes,
            reports=self._reports,
        )
        self.found = find(snapshot)
        snapshot = replace(snapshot, totals=self.totals, found=self.found)
        try:
            for event in self.decision_log.follow(snapshot):
                self._tell(event)
        except Exception:
            # A fault in the log must not stop the daemon.
            if not self._has_failed:
                log.exception("the decision log failed and misses events; not logged again")
            self._has_failed = True
        self.totals = replace(self.totals, events_by_kind=self.decision_log.counts_by_kind)
        self.snapshot = replace(snapshot, totals=self.totals, events=self.decision_log.events)
        self.counted += 1
        self.history.note(self.snapshot)
