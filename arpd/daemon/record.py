"""The record of a daemon: its counts, decision log and history, and the snapshot that shows them all."""

from __future__ import annotations

import logging
from collections import Counter, deque
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.report.decision_log import DecisionLog
from arpd.report.history import History
from arpd.report.situation import since_when
from arpd.report.snapshot import Snapshot, Totals

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.daemon.reload import Configuration
    from arpd.daemon.world import World
    from arpd.govern.governor import Governor
    from arpd.model.allocation import Allocation
    from arpd.report.events import Event
    from arpd.solve.program import Program

log = logging.getLogger(__name__)
_MOST_LATE = 1000  # beginnings of ticks that no whole turn has counted yet


class Record:
    """Keeps the results of the daemon's ticks.

    Parameters
    ----------
    tell : called with each event of the decision log

    Attributes
    ----------
    snapshot : the daemon after its last finished tick, None before the first
    turns : whole turns so far
    history : the last ten minutes
    """

    def __init__(self, *, tell: Callable[[Event], None]) -> None:
        self.snapshot: Snapshot | None = None
        self.turns = 0
        self.history = History()
        self._tell = tell
        self._totals = Totals()
        self._solves: Counter[tuple[str, str]] = Counter()  # by programs of earlier configurations
        self._decision_log = DecisionLog()
        self._has_failed = False  # whether the decision log raised
        self._followed: list[float] = []  # durations of the ticks since the last whole turn (s)
        self._late: deque[tuple[float, bool]] = deque(maxlen=_MOST_LATE)  # how late ticks began (s), and if it counts
        self._reports = 0
        self._allocation: Allocation | None = None

    def note_failed_tick(self) -> None:
        """Count a tick that raised, and show it at once: no tick may finish for a while."""
        self._totals = replace(self._totals, ticks_failed=self._totals.ticks_failed + 1)
        if self.snapshot is not None:
            totals = replace(self.snapshot.totals, ticks_failed=self._totals.ticks_failed)
            self.snapshot = replace(self.snapshot, totals=totals)

    def note_lateness(self, late_s: float, *, is_late: bool) -> None:
        """Note how late a tick begins (s)."""
        self._late.append((late_s, is_late))

    def follow(self, picture: Snapshot) -> None:
        """Publish the snapshot of a tick that was no whole turn: what the link is, and the price."""
        self._followed.append(picture.tick_s)
        self._reports += len(picture.observation.reports)
        self.snapshot = picture

    def keep_counts_of(self, program: Program) -> None:
        """Keep the counts of a program that is about to be replaced."""
        self._solves.update(program.outcomes)

    def add(
        self, picture: Snapshot, *, world: World, program: Program, governor: Governor, configuration: Configuration
    ) -> None:
        """Count a whole turn and the ticks before it, add its events to the decision log, and publish the snapshot.

        Parameters
        ----------
        picture : the tick, without counts and events
        """
        self._totals = self._count(picture, world, program, governor, configuration)
        before = self.snapshot.since_s if self.snapshot is not None else {}
        picture = replace(picture, totals=self._totals, since_s=before)
        picture = replace(picture, since_s=since_when(picture))
        try:
            for event in self._decision_log.follow(picture):
                self._tell(event)
        except Exception:
            # A fault in the log must not stop the daemon.
            if not self._has_failed:
                log.exception("the decision log failed and misses events; not logged again")
            self._has_failed = True
        totals = replace(picture.totals, events_by_kind=self._decision_log.counts_by_kind)
        self.snapshot = replace(picture, totals=totals, events=self._decision_log.events)
        self.turns += 1
        self.history.note(self.snapshot)

    def _count(
        self, picture: Snapshot, world: World, program: Program, governor: Governor, configuration: Configuration
    ) -> Totals:
        probes, probe_bytes = world.probes_sent()
        is_solved, self._allocation = picture.allocation is not self._allocation, picture.allocation
        followed, self._followed = self._followed, []
        late = [self._late.popleft() for _ in range(len(self._late))]
        solves = self._solves + Counter(program.outcomes)
        reports, self._reports = self._reports + len(picture.observation.reports), 0
        return replace(
            self._totals,
            ticks=self._totals.ticks + len(followed) + 1,
            ticks_late=self._totals.ticks_late + sum(is_late for _, is_late in late),
            solves_by_outcome=MappingProxyType(dict(solves)),
            cross_check_disagreements=sum(count for (_, how), count in solves.items() if how == "disagreed"),
            plans_by_cause=MappingProxyType(dict(governor.plans_by_cause)),
            refusals_by_reason=MappingProxyType(dict(governor.refusals_by_reason)),
            applies_by_result=MappingProxyType(dict(world.results())),
            probes=probes,
            probe_bytes=probe_bytes,
            reports=self._totals.reports + reports,
            reloads_by_result=MappingProxyType(dict(configuration.reloads_by_result)),
            changed_keys_by_effect=MappingProxyType(dict(configuration.changed_keys_by_effect)),
            durations=self._totals.durations.with_ticks(
                [*followed, picture.tick_s],
                late_s=[late_s for late_s, _ in late],
                solve_s=picture.allocation.solve_s if is_solved else None,
            ),
        )
