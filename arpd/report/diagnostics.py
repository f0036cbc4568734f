"""ROS diagnostics of the daemon: four statuses, each with a level, a sentence and values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import TYPE_CHECKING

from arpd.model.quantities import format_duration, format_number, format_rate, format_share
from arpd.report.conditions import Condition, Severity
from arpd.report.situation import judge, who_confirmed

if TYPE_CHECKING:
    from arpd.report.situation import Situation
    from arpd.report.snapshot import Snapshot

_RECENT_S = 60.0
_MOST_EVENTS = 10
_MOST_TOPICS = 10
_MOST_PEERS = 5
_NAMES = ("arpd: link", "arpd: plan", "arpd: configuration", "arpd: events")


class Level(IntEnum):
    """Level of a status; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


_LEVEL_OF = {Severity.INFO: Level.OK, Severity.WARNING: Level.WARN, Severity.ERROR: Level.ERROR}


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
    """Return all statuses; they are stale while no tick finishes, and before the first.

    Parameters
    ----------
    now_s : monotonic clock (s)
    """
    if snapshot is None:
        return tuple(Status(name=name, level=Level.STALE, message="starting") for name in _NAMES)
    situation = judge(snapshot, now_s=now_s)
    carries = f"{format_rate(snapshot.link.capacity_bytes_per_second)}, {snapshot.link.state}"
    runs = f"plan {snapshot.decision.plan.generation}: {who_confirmed(snapshot)}"
    loaded = f"in force since {_time(snapshot.config_loaded_at_s)}"
    statuses = (
        _judged("link", situation, carries, _link_values(snapshot)),
        _judged("plan", situation, runs, _plan_values(snapshot, situation)),
        _judged("configuration", situation, loaded, _configuration_values(snapshot)),
        _events(snapshot, now_s=now_s),
    )
    stale = next((each.text for each in situation.faults if each.condition is Condition.STALE), "")
    if not stale:
        return statuses
    return tuple(Status(name=each.name, level=Level.STALE, message=stale, values=each.values) for each in statuses)


def _judged(part: str, situation: Situation, otherwise: str, values: tuple[tuple[str, str], ...]) -> Status:
    """Return a status with the most important finding of its part, or another message without any."""
    finding = next((each for each in situation.findings if each.condition.part == part), None)
    if finding is None:
        return Status(name=f"arpd: {part}", level=Level.OK, message=otherwise, values=values)
    level = _LEVEL_OF[finding.condition.severity]
    return Status(name=f"arpd: {part}", level=level, message=finding.text, values=values)


def _link_values(snapshot: Snapshot) -> tuple[tuple[str, str], ...]:
    link, peers = snapshot.link, [*snapshot.observation.peer_ages_s.items()][:_MOST_PEERS]
    return (
        ("interface", snapshot.interface),
        ("capacity", format_rate(link.capacity_bytes_per_second)),
        ("known from", f"{link.kind}: {link.evidence}" if link.evidence else str(link.kind)),
        ("known for", format_duration(link.age_s)),
        ("left for topics", format_rate(link.available_bytes_per_second)),
        ("budget of topics", format_rate(snapshot.allocation.capacity_bytes_per_second)),
        ("cross traffic", format_rate(link.cross_traffic_bytes_per_second)),
        ("delivered", format_rate(link.delivery_rate_bytes_per_second)),
        ("queue delay", format_duration(link.queue_delay_s)),
        ("loss", "unknown" if link.loss_ratio is None else format_share(link.loss_ratio)),
        ("return delay", "unknown" if link.return_delay_s is None else format_duration(link.return_delay_s)),
        (
            "peers",
            ", ".join(f"{peer} ({format_duration(age_s)} ago)" for peer, age_s in peers) or "none",
        ),
    )


def _plan_values(snapshot: Snapshot, situation: Situation) -> tuple[tuple[str, str], ...]:
    decision = snapshot.decision
    slowed = [
        (topic, f"{format_number(rate_hz)} of {format_number(source_hz)} Hz")
        for _, topic, rate_hz, source_hz in situation.slowed
    ]
    more = len(slowed) - _MOST_TOPICS
    return (
        ("plan", str(decision.plan.generation)),
        ("made for", format_rate(decision.plan.level_bytes_per_second)),
        ("bound by", str(snapshot.allocation.binding)),
        ("allowed above the minimum rates", format_share(decision.allowed)),
        ("publishers confirmed", f"{snapshot.confirmed} of {snapshot.managed}"),
        ("waits for", ", ".join(decision.refusals) or "nothing"),
        *slowed[:_MOST_TOPICS],
        *([("further topics slowed", str(more))] if more > 0 else []),
    )


def _configuration_values(snapshot: Snapshot) -> tuple[tuple[str, str], ...]:
    return (
        ("file", snapshot.config_path),
        ("read at", _time(snapshot.config_loaded_at_s)),
        ("refused", snapshot.config_error or "no"),
        ("after a restart", ", ".join(snapshot.keys_awaiting_restart) or "nothing"),
        ("version", snapshot.version),
    )


def _events(snapshot: Snapshot, *, now_s: float) -> Status:
    """Return the last events; the worst one within a minute sets the level."""
    events = snapshot.events
    recent = (event for event in events if now_s - event.at_s < _RECENT_S)
    return Status(
        name="arpd: events",
        level=max((_LEVEL_OF[event.severity] for event in recent), default=Level.OK),
        message=events[-1].text if events else "nothing has happened yet",
        values=tuple(
            (f"{_time(event.unix_time_s)} {event.kind}", event.text) for event in reversed(events[-_MOST_EVENTS:])
        ),
    )


def _time(unix_time_s: float) -> str:
    if not (math.isfinite(unix_time_s) and 0 <= unix_time_s < 2**40):
        return "unknown"
    return datetime.fromtimestamp(unix_time_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
