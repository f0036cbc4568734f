"""The daemon: its tick, its reload and its restoring; knows no ROS, no HTTP and no systemd."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.adapters.config.load import describe_change, in_force, restart_only_changes
from arpd.apply.ordering import Ordering
from arpd.apply.readers import plan_readers, restore_readers
from arpd.apply.transitions import paced_restore_plan, restore_plan
from arpd.estimate.estimator import Estimator
from arpd.govern.governor import Governor
from arpd.model.errors import ConfigError
from arpd.model.interface import state_of
from arpd.model.settings import AUTO, Backend
from arpd.model.version import VERSION
from arpd.report.decision_log import Chronicle
from arpd.report.durations import SwapWatch
from arpd.report.history import History
from arpd.report.snapshot import Snapshot, Totals
from arpd.solve.program import Program
from arpd.solve.topics import memory_budget_bytes, topics_to_plan

if TYPE_CHECKING:
    from collections.abc import Callable

    from arpd.daemon.world import CapacityEstimator, World
    from arpd.model.allocation import Allocation
    from arpd.model.observation import Observation
    from arpd.model.plan import Decision
    from arpd.model.settings import Settings
    from arpd.report.events import Event

log = logging.getLogger(__name__)

TICK_S = 0.1
_RESTORE_S = 8.0  # a swap settles for three seconds, proves itself and is announced
_RESTORE_READERS_S = 4.0  # what readers that go first may take beyond that
_UNPACE_S = 3.0  # what the rates, which need no swap, may take after that
_MOST_FAULTS = 20  # in the log; `arpd check` names all
_HEAR_S = 2.5  # until everybody who carries a plan, and another daemon, has been heard


class Daemon:
    """Runs the tick over a world.

    Parameters
    ----------
    world : what is observed and acted on
    settings : the configuration in force
    interface : the link interface as configured; the snapshot has the name it is found under
    config_path : the file the settings came from, for the snapshot
    clock, wall_clock : monotonic and Unix time (s)
    estimator : what tells the capacity; `arpd.estimate.estimator.Estimator` by default, another to compare it with
    tell : told of every event of the decision log
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        *,
        interface: str,
        config_path: str = "",
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        estimator: CapacityEstimator | None = None,
        tell: Callable[[Event], None] = lambda _event: None,
    ) -> None:
        self._world = world
        self._settings = settings
        self._interface = interface
        self._has_interface = False  # whether it was ever there
        self._config_path = config_path
        self._config_error = ""
        self._config_loaded_at_s = wall_clock()
        self._awaiting_restart: tuple[str, ...] = ()
        self._began_s: float | None = None  # when the world was first observed
        self._clock = clock
        self._wall_clock = wall_clock
        self._estimator: CapacityEstimator = estimator or Estimator(settings.link)
        self._governor = Governor(settings)
        self._program = self._program_of(settings)
        self._solves: Counter[tuple[str, str]] = Counter()  # by programs of earlier configurations
        self._disagreements = 0
        self._ordering = Ordering()
        self._totals = Totals()
        self._swaps = SwapWatch()
        self._reloads: Counter[str] = Counter()
        self._changed_keys: Counter[str] = Counter()
        self._tell = tell
        self._chronicle = Chronicle()
        self._is_untold = False  # whether the decision log failed
        self.history = History()
        self.snapshot: Snapshot | None = None

    @property
    def settings(self) -> Settings:
        """Configuration in force."""
        return self._settings

    @property
    def interface(self) -> str:
        """The link interface by the name it has now, or had last; as configured before it was found."""
        return self._interface

    def tick(self, now_s: float) -> Decision:
        """Observe → estimate → solve → govern → apply, once."""
        observation = self._observe(now_s)
        link = self._estimator.update(observation)
        topics = topics_to_plan(observation.publishers, self._settings) if self._estimator.has_evidence else ()
        memory = memory_budget_bytes(observation.memory, self._settings.program)
        allocation = self._program.solve(
            link.available_bytes_per_second, topics, memory, packet_overhead_s=link.available_packet_overhead_s
        )
        if observation.superior:
            decision = self._governor.stand_by()
        else:
            decision = self._governor.decide(
                now_s,
                link=link,
                allocation=allocation,
                topics=topics,
                publishers=observation.publishers,
                newest=max((reader.generation for reader in observation.readers), default=0),
            )
            self._world.set_gate(decision.gate)
        reader_plans = plan_readers(observation.readers, decision.plan)
        steps = self._ordering.steps(
            now_s,
            publishers=observation.publishers,
            readers=observation.readers,
            plan=decision.plan,
            reader_plans=reader_plans,
            reason=decision.reason,
            lease_s=self._settings.lease_s,
        )
        if not observation.superior:
            self._world.apply(steps.transitions, now_s=now_s)
            for request in self._estimator.wanted_probes(now_s):
                self._world.probe(request)
        finished_s = self._clock()
        self._totals = self._count(observation, allocation, tick_s=finished_s - now_s)
        picture = Snapshot(
            version=VERSION,
            interface=self._interface,
            finished_at_s=finished_s,
            unix_time_s=self._wall_clock(),
            tick_s=finished_s - now_s,
            observation=observation,
            link=link,
            allocation=allocation,
            decision=decision,
            totals=self._totals,
            config_path=self._config_path,
            config_error=self._config_error,
            confirmed=steps.confirmed,
            reader_plans=MappingProxyType(reader_plans),
            readers_confirmed=steps.readers_confirmed,
            lease_s=self._settings.lease_s,
            config_loaded_at_s=self._config_loaded_at_s,
            keys_awaiting_restart=self._awaiting_restart,
        )
        self._publish(picture)
        return decision

    def _publish(self, picture: Snapshot) -> None:
        """Write what happened into the decision log, and let everybody see the snapshot with it."""
        try:
            for event in self._chronicle.follow(picture):
                self._tell(event)
        except Exception:
            # What cannot be told must not keep the robot from being governed.
            if not self._is_untold:
                log.exception("the decision log misses what happened; said once")
            self._is_untold = True
        totals = replace(picture.totals, events_by_kind=self._chronicle.counts_by_kind)
        self.snapshot = replace(picture, totals=totals, events=self._chronicle.events)
        self.history.note(self.snapshot)

    def _observe(self, now_s: float) -> Observation:
        observation = self._world.observe(now_s)
        if self._began_s is None:
            self._began_s = now_s
        if observation.counters is not None:
            self._interface, self._has_interface = observation.counters.interface, True
        return observation

    def note_failed_tick(self) -> None:
        """Count a tick that raised, and show it: there may be no other for a while."""
        self._totals = replace(self._totals, ticks_failed=self._totals.ticks_failed + 1)
        if self.snapshot is not None:
            totals = replace(self.snapshot.totals, ticks_failed=self._totals.ticks_failed)
            self.snapshot = replace(self.snapshot, totals=totals)

    def note_lateness(self, late_s: float) -> None:
        """Count how late a tick begins; more than half a period is late (s)."""
        self._totals = replace(
            self._totals,
            ticks_late=self._totals.ticks_late + (late_s > TICK_S / 2),
            durations=self._totals.durations.with_lateness(late_s),
        )

    def note_failed_reload(self, why: str) -> None:
        """Count a reload that was refused; ``why`` shows in the status until one succeeds."""
        self._config_error = why
        self._reloads["failed"] += 1

    def reload(self, load: Callable[[], Settings]) -> bool:
        """Take a new configuration whole, or keep the old one whole.

        What is read at start only stays in force as it was, and is named as waiting for a restart.

        Parameters
        ----------
        load : reads and checks the new configuration; raises ConfigError

        Returns
        -------
        Whether the new configuration is in force.
        """
        try:
            wanted = load()
        except ConfigError as error:
            for fault in error.faults[:_MOST_FAULTS]:
                log.error("%s", fault)  # noqa: TRY400 - the fault names its place; a traceback would bury it
            if (more := len(error.faults) - _MOST_FAULTS) > 0:
                log.error("further faults: %d", more)  # noqa: TRY400 - the same
            self.note_failed_reload(error.faults[0])
            return False
        before, fresh = self._settings, in_force(self._settings, wanted)
        if fresh != before:
            self._take(fresh)
        changes, awaiting = describe_change(before, fresh), restart_only_changes(before, wanted)
        for change in changes:
            log.info("reloaded: %s", change)
        for change in describe_change(fresh, wanted):
            log.warning("%s; takes effect after a restart", change)
        self._changed_keys.update(in_force=len(changes), awaiting_restart=len({*awaiting} - {*self._awaiting_restart}))
        self._awaiting_restart = tuple(awaiting)
        self._config_error = ""
        self._config_loaded_at_s = self._wall_clock()
        self._reloads["ok"] += 1
        return True

    def _take(self, fresh: Settings) -> None:
        """Bring settings into force everywhere, or nowhere."""
        program = self._program_of(fresh)  # what can fail comes first
        try:
            self._reconfigure(fresh)
        except BaseException:
            self._reconfigure(self._settings)
            raise
        self._solves.update(self._program.outcomes)
        self._disagreements += self._program.disagreements
        self._settings, self._program = fresh, program

    def _reconfigure(self, settings: Settings) -> None:
        self._world.reconfigure(settings.graph)
        self._estimator.reconfigure(settings.link)
        self._governor.reconfigure(settings)

    def _program_of(self, settings: Settings) -> Program:
        try:
            return Program.of(settings, clock=self._clock)
        except ImportError as error:
            log.error("program.backend: %s cannot be used (%s); exact takes over", settings.program.backend, error)  # noqa: TRY400 - nothing of ours to trace
            return Program.of(settings, backend=Backend.EXACT, clock=self._clock)

    def restore(self, *, wait: Callable[[float], None]) -> int:
        """Give every managed publisher and reader its application's QoS back, and wait for the announcements.

        The rates go last: on a link that cannot carry what the applications publish, no new writer would prove itself.

        Parameters
        ----------
        wait : sleeps for the given time (s)

        Returns
        -------
        Number of publishers and readers that did not confirm in time.
        """
        ordering = Ordering(patience_s=_RESTORE_READERS_S)
        generation = self._governor.plan.generation + 1
        self._observe(self._clock())
        while (begun_s := self._clock()) - (self._began_s or 0.0) < _HEAR_S:
            # A predecessor's plan may be in force, or another daemon in charge: nobody was heard yet.
            wait(TICK_S)
            self._observe(self._clock())
        plan_of = paced_restore_plan
        while True:
            now_s = self._clock()
            observation = self._observe(now_s)
            if observation.superior:
                return 0  # what is in force is another daemon's
            # Whatever carries a plan, be it a predecessor's, or of a topic whose far reader has left.
            publishers = [publisher for publisher in observation.publishers if publisher.generation > 0]
            generation = max([generation, *(publisher.generation for publisher in publishers)])
            generation = max([generation, *(reader.generation for reader in observation.readers)])
            reader_plans = restore_readers(observation.readers)
            steps = ordering.steps(
                now_s,
                publishers=publishers,
                readers=observation.readers,
                plan=plan_of(publishers, generation=generation),
                reader_plans=reader_plans,
                reason="stop",
            )
            missing = len(publishers) - steps.confirmed + len(reader_plans) - steps.readers_confirmed
            patience_s = _RESTORE_S + (_RESTORE_READERS_S if reader_plans else 0.0)
            is_done, spent_s = not (missing or steps.transitions), now_s - begun_s
            if plan_of is paced_restore_plan and (is_done or spent_s > patience_s):
                plan_of = restore_plan
                continue
            if is_done or spent_s > patience_s + _UNPACE_S:
                return missing
            self._world.set_gate(1.0)
            self._world.apply(steps.transitions, now_s=now_s)
            wait(TICK_S)

    def status_line(self) -> str:
        """One line a human can read, for ``systemctl status``."""
        if self.snapshot is None:
            return "starting"
        if superior := self.snapshot.observation.superior:
            return f"standing by: another arpd daemon, on {superior}, drives this robot"
        link, decision = self.snapshot.link, self.snapshot.decision
        line = (
            f"{link.capacity_bytes_per_second * 8e-6:.1f} Mbit/s ({link.kind}, {link.state}, "
            f"{link.foreign_bytes_per_second * 8e-6:.1f} foreign), "
            f"gate {decision.gate:.2f}, plan {decision.plan.generation}: "
            f"{self.snapshot.confirmed} of {self.snapshot.managed} publishers confirmed"
        )
        refused = f"reload refused: {self._config_error}" if self._config_error else ""
        waiting = f"restart needed for {', '.join(self._awaiting_restart[:3])}" if self._awaiting_restart else ""
        if (more := len(self._awaiting_restart) - 3) > 0:
            waiting += f" and {more} more"
        return "; ".join(said for said in (self._interface_fault(), line, refused, waiting) if said)

    def _interface_fault(self) -> str:
        """Say why the link interface carries nothing, empty when it does."""
        assert self.snapshot is not None
        fault = state_of(self.snapshot.observation.counters).fault
        if not fault:
            return ""
        if self._has_interface:
            return f"{self._interface} {fault}"
        return "no link interface is there yet" if self._interface == AUTO else f"{self._interface} is not there yet"

    def _count(self, observation: Observation, allocation: Allocation, *, tick_s: float) -> Totals:
        probes, probe_bytes = self._world.probes_sent()
        is_solved = self.snapshot is None or allocation is not self.snapshot.allocation
        return replace(
            self._totals,
            ticks=self._totals.ticks + 1,
            solves_by_outcome=MappingProxyType(dict(self._solves + Counter(self._program.outcomes))),
            cross_check_disagreements=self._disagreements + self._program.disagreements,
            levels_by_cause=MappingProxyType(dict(self._governor.levels_by_cause)),
            refusals_by_reason=MappingProxyType(dict(self._governor.refusals_by_reason)),
            applies_by_result=MappingProxyType(dict(self._world.results())),
            probes=probes,
            probe_bytes=probe_bytes,
            reports=self._totals.reports + len(observation.reports),
            reloads_by_result=MappingProxyType(dict(self._reloads)),
            changed_keys_by_effect=MappingProxyType(dict(self._changed_keys)),
            durations=self._totals.durations.with_tick(
                tick_s,
                solve_s=allocation.solve_s if is_solved else None,
                phases=self._swaps.look(observation.publishers),
            ),
        )
