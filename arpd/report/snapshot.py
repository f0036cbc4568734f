"""The daemon after a tick, as one immutable value; metrics, status and log have no other source."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from arpd.model.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.allocation import Allocation, Decision
    from arpd.model.link import LinkEstimate
    from arpd.model.observation import Observation
    from arpd.report.conditions import Event, Finding


@dataclass(frozen=True, kw_only=True, slots=True)
class Totals:
    """Counts since the daemon started; attempts and failures have counts of their own.

    Parameters
    ----------
    ticks, ticks_failed, ticks_late : finished, raised, started more than half a period late
    solves_by_outcome : (backend, outcome) → count; outcome as in `arpd.solve.backends.Solver`
    plans_by_cause : plans made, by cause (``start``, ``down``, ``up``, ``demand``, ``memory`` …)
    applies_by_result : answers of nodes to plans, by result (``ok``, ``refused``, ``timeout``)
    probes, probe_bytes : trains and pings put on the link, and their wire bytes
    reports : peer reports received
    events_by_kind : lines of the decision log, by their kind
    """

    ticks: int = 0
    ticks_failed: int = 0
    ticks_late: int = 0
    solves_by_outcome: Mapping[tuple[str, str], int] = field(default_factory=lambda: MappingProxyType({}))
    plans_by_cause: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    applies_by_result: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    probes: int = 0
    probe_bytes: int = 0
    reports: int = 0
    events_by_kind: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, kw_only=True, slots=True)
class Snapshot:
    """The daemon after one finished tick.

    Parameters
    ----------
    version : arpd's version
    interface : link interface in use; as configured until it was found
    has_interface : True once it was there
    finished_at_s : monotonic clock when the tick finished (s)
    unix_time_s : wall clock at the same moment (s)
    tick_s : how long the tick took (s)
    observation, link, allocation, decision : what the stages of the tick returned
    totals : counts since start
    settings : configuration in force
    config_path : its file
    config_error : first line of why the last reload was refused, empty when it was accepted
    config_loaded_at_s : wall clock when the configuration in force was read (s)
    keys_awaiting_restart : keys whose value in the file last read takes effect after a restart
    confirmed : number of managed publishers whose announcement matches the plan
    found : conditions that held, and since when, as of the last tick that planned
    events : the last of the decision log, oldest first
    """

    version: str
    interface: str
    finished_at_s: float
    unix_time_s: float
    tick_s: float
    observation: Observation
    link: LinkEstimate
    allocation: Allocation
    decision: Decision
    totals: Totals
    settings: Settings = field(default_factory=Settings)
    config_path: str = ""
    config_error: str = ""
    config_loaded_at_s: float = 0.0
    keys_awaiting_restart: tuple[str, ...] = ()
    has_interface: bool = True
    confirmed: int = 0
    found: tuple[Finding, ...] = ()
    events: tuple[Event, ...] = ()

    @property
    def managed(self) -> int:
        """Number of live publishers that the plan in force covers."""
        planned = self.decision.plan.topics
        return sum(publisher.topic in planned for publisher in self.observation.publishers)

    @property
    def paced_only(self) -> int:
        """Number of managed publishers that refuse new QoS for good."""
        planned = self.decision.plan.topics
        return sum(p.topic in planned and p.refusal_reason.is_lasting for p in self.observation.publishers)
