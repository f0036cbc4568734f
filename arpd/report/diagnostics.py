"""How the daemon is, as ROS diagnostics tell it: four statuses with a level, a sentence and values for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import TYPE_CHECKING

from arpd.model.allocation import AllocationStatus
from arpd.model.interface import state_of
from arpd.model.link import LinkState
from arpd.report.events import Severity
from arpd.report.wording import digits, duration, listed, rate

if TYPE_CHECKING:
    from arpd.report.events import Event
    from arpd.report.snapshot import Snapshot

_STALE_S = 3.0  # ten ticks a second
_RECENT_S = 60.0
_MOST_EVENTS = 10
_MOST_TOPICS = 10


class Level(IntEnum):
    """How bad it is; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Status:
    """One part of the daemon.

    Parameters
    ----------
    name : "arpd: link"; an aggregator sorts by it
    message : one line
    values : further facts, in order
    """

    name: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...] = ()


def diagnose(snapshot: Snapshot | None, *, now_s: float) -> tuple[Status, ...]:
    """Return all statuses; they are stale while ticks fail, and before the first.

    Parameters
    ----------
    now_s : monotonic clock (s)
    """
    if snapshot is None:
        return tuple(Status(name=name, level=Level.STALE, message="starting") for name in _PARTS)
    statuses = tuple(tell(name, snapshot) for name, tell in _PARTS.items())
    if (age_s := now_s - snapshot.finished_at_s) <= _STALE_S:
        return statuses
    message = f"ticks fail, the last one finished {duration(age_s)} ago"
    return tuple(
        Status(name=status.name, level=Level.STALE, message=message, values=status.values) for status in statuses
    )


def _link(name: str, snapshot: Snapshot) -> Status:
    link, fault = snapshot.link, state_of(snapshot.observation.counters).fault
    carries = rate(link.capacity_bytes_per_second)
    if fault:
        level, message = Level.ERROR, f"{snapshot.interface} {fault}"
    elif link.state is LinkState.OUTAGE:
        level, message = Level.ERROR, "the link carries nothing: floors only"
    else:
        is_busy = link.state in {LinkState.CONGESTED, LinkState.DRAINING}
        level = Level.WARN if is_busy else Level.OK
        message = f"{carries}, {link.state}" + (f", queue {duration(link.queue_delay_s)}" if is_busy else "")
    peers = snapshot.observation.peer_ages_s
    return Status(
        name=name,
        level=level,
        message=message,
        values=(
            ("interface", snapshot.interface),
            ("capacity", carries),
            ("known from", f"{link.kind}: {link.evidence}" if link.evidence else str(link.kind)),
            ("known for", duration(link.age_s)),
            ("left for topics", rate(link.available_bytes_per_second)),
            ("other traffic", rate(link.cross_traffic_bytes_per_second)),
            ("delivered", rate(link.delivery_rate_bytes_per_second)),
            ("queue delay", duration(link.queue_delay_s)),
            ("loss", "unknown" if link.loss_ratio is None else f"{digits(100 * link.loss_ratio)} %"),
            ("way back", "unknown" if link.return_delay_s is None else duration(link.return_delay_s)),
            ("peers", ", ".join(f"{peer} ({duration(age_s)} ago)" for peer, age_s in [*peers.items()][:5]) or "none"),
        ),
    )


def _plan(name: str, snapshot: Snapshot) -> Status:
    decision, allocation, observation = snapshot.decision, snapshot.allocation, snapshot.observation
    plan = decision.plan
    if observation.active_daemon:
        level, message = (
            Level.WARN,
            f"standing by: another arpd daemon, on {observation.active_daemon}, drives this robot",
        )
    elif plan.generation == 0:
        level, message = Level.OK, "no plan yet" if observation.publishers else "no topic to plan for"
    elif allocation.status is AllocationStatus.DEGRADED:
        level, message = Level.WARN, f"not everything that was asked for fits: {allocation.degradation}"
    else:
        message = f"plan {plan.generation}: {snapshot.confirmed} of {snapshot.managed} publishers confirmed"
        level = Level.OK
    return Status(
        name=name,
        level=level,
        message=message,
        values=(
            ("plan", str(plan.generation)),
            ("made for", rate(plan.level_bytes_per_second)),
            ("bound by", str(allocation.binding)),
            ("gate", f"{decision.gate:.2f}"),
            ("publishers confirmed", f"{snapshot.confirmed} of {snapshot.managed}"),
            ("readers confirmed", f"{snapshot.readers_confirmed} of {len(snapshot.reader_plans)}"),
            ("waits for", ", ".join(decision.refusals) or "nothing"),
            *_slowed(snapshot),
        ),
    )


def _slowed(snapshot: Snapshot) -> list[tuple[str, str]]:
    """Return the topics that may send less than their sources give, the most slowed first."""
    planned = snapshot.decision.plan.topics
    slowed = sorted(
        (row.rate_hz / publisher.source_rate_hz, publisher.topic, row.rate_hz, publisher.source_rate_hz)
        for publisher in snapshot.observation.publishers
        if (row := planned.get(publisher.topic)) is not None and row.rate_hz < publisher.source_rate_hz
    )
    named = [(topic, f"{digits(given)} of {digits(wanted)} Hz") for _, topic, given, wanted in slowed[:_MOST_TOPICS]]
    more = len(slowed) - len(named)
    return [*named, *([("further topics slowed", str(more))] if more else [])]


def _configuration(name: str, snapshot: Snapshot) -> Status:
    waiting = snapshot.keys_awaiting_restart
    if snapshot.config_error:
        level, message = Level.ERROR, f"reload refused: {snapshot.config_error}"
    elif waiting:
        level, message = Level.WARN, f"restart needed for {listed(waiting)}"
    else:
        level, message = Level.OK, f"in force since {_time(snapshot.config_loaded_at_s)}"
    return Status(
        name=name,
        level=level,
        message=message,
        values=(
            ("file", snapshot.config_path),
            ("read at", _time(snapshot.config_loaded_at_s)),
            ("refused", snapshot.config_error or "no"),
            ("after a restart", ", ".join(waiting) or "nothing"),
            ("version", snapshot.version),
        ),
    )


_LEVEL_OF = {Severity.INFO: Level.OK, Severity.WARNING: Level.WARN, Severity.ERROR: Level.ERROR}


def _events(name: str, snapshot: Snapshot) -> Status:
    """Tell the last event; the level is that of the worst one within a minute."""
    events = snapshot.events
    recent = (event for event in events if snapshot.unix_time_s - event.unix_time_s < _RECENT_S)
    return Status(
        name=name,
        level=max((_LEVEL_OF[event.severity] for event in recent), default=Level.OK),
        message=events[-1].text if events else "nothing has happened yet",
        values=tuple((_key(event), event.text) for event in reversed(events[-_MOST_EVENTS:])),
    )


def _key(event: Event) -> str:
    return f"{_time(event.unix_time_s)} {event.kind}"


def _time(unix_time_s: float) -> str:
    if not (math.isfinite(unix_time_s) and 0 <= unix_time_s < 2**40):
        return "unknown"
    return datetime.fromtimestamp(unix_time_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


_PARTS = {"arpd: link": _link, "arpd: plan": _plan, "arpd: configuration": _configuration, "arpd: events": _events}
