"""The record of a daemon: its counts, decision log and history, and the snapshot that shows them all."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from prometheus_client import Histogram, disable_created_metrics

from arpd.report.decision_log import DecisionLog
from arpd.report.history import History
from arpd.report.situation import find
from arpd.report.snapshot import Totals

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.daemon.world import World
    from arpd.govern.governor import Governor
    from arpd.report.conditions import Event, Finding
    from arpd.report.snapshot import Snapshot
    from arpd.solve.program import Program

log = logging.getLogger(__name__)
_LATE_S = 0.05  # half a period
# A tick has 0.1 s, and one that begins 0.05 s late counts as late: both are bounds.
_TICK_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
# A dozen topics take a millisecond, a thousand some ten (scripts/bench/solve.py).
_SOLVE_S = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25)


class Durations(NamedTuple):
    """Durations of finished ticks, the delays with which ticks began, and the durations of solves (s)."""

    ticks: Histogram
    lateness: Histogram
    solves: Histogram


def new_durations() -> Durations:
    """Return empty histograms, in no registry yet."""
    disable_created_metrics()  # type: ignore[no-untyped-call]

    def empty(name: str, text: str, bounds_s: Sequence[float]) -> Histogram:
        return Histogram(f"arpd_{name}_seconds", text, registry=None, buckets=bounds_s)

    late = "Delay after the planned time at which ticks began; above 0.05 counts as late."
    solve = "Duration of solves of the whole program, one for each tick that plans."
    return Durations(
        ticks=empty("tick_duration", "Duration of finished ticks.", _TICK_S),
        lateness=empty("tick_lateness", late, _TICK_S),
        solves=empty("solve_duration", solve, _SOLVE_S),
    )


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
    durations : of all ticks and solves
    """

    def __init__(self, *, tell: Callable[[Event], None]) -> None:
        self.snapshot: Snapshot | None = None
        self.totals = Totals()
        self.events: tuple[Event, ...] = ()
        self.found: tuple[Finding, ...] = ()
        self.counted = 0
        self.history = History()
        self.durations = new_durations()
        self._tell = tell
        self._decision_log = DecisionLog()
        self._has_failed = False  # whether the decision log raised
        self._ticks = self._late = self._reports = 0

    def note_failed_tick(self) -> None:
        """Count a tick that raised, and show it at once: no tick may finish for a while."""
        self.totals = replace(self.totals, ticks_failed=self.totals.ticks_failed + 1)
        if self.snapshot is not None:
            totals = replace(self.snapshot.totals, ticks_failed=self.totals.ticks_failed)
            self.snapshot = replace(self.snapshot, totals=totals)

    def note_lateness(self, late_s: float) -> None:
        """Note how late a tick begins (s)."""
        self.durations.lateness.observe(late_s)
        self._late += late_s > _LATE_S

    def note(self, snapshot: Snapshot) -> None:
        """Publish the snapshot of a tick."""
        self.durations.ticks.observe(snapshot.tick_s)
        self._ticks += 1
        self._reports += len(snapshot.observation.reports)
        self.snapshot = snapshot

    def count(self, *, world: World, program: Program, governor: Governor) -> None:
        """Count the ticks up to one that planned, and add its events to the decision log."""
        if (picture := self.snapshot) is None:
            return
        if picture.allocation.topics:
            self.durations.solves.observe(picture.allocation.solve_s)
        probes, probe_bytes = world.probes_sent()
        self.totals = replace(
            self.totals,
            ticks=self._ticks,
            ticks_late=self._late,
            solves_by_outcome=MappingProxyType(dict(program.outcomes)),
            plans_by_cause=MappingProxyType(dict(governor.plans_by_cause)),
            refusals_by_reason=MappingProxyType({"budget": governor.postponed}),
            applies_by_result=MappingProxyType(dict(world.results())),
            probes=probes,
            probe_bytes=probe_bytes,
            reports=self._reports,
        )
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
