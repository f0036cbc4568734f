"""ROS diagnostics of the daemon: four statuses, each with a level, a sentence and values."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.quantities import format_duration, format_number, format_rate, format_share
from arpd.report.conditions import Condition, Severity
from arpd.report.situation import Situation, judge, who_confirmed

if TYPE_CHECKING:
    from arpd.report.snapshot import Snapshot

_RECENT_S = 60.0
_MOST_EVENTS = 10
_MOST_TOPICS = 10
_MOST_PEERS = 5
_PARTS = ("link", "plan", "configuration", "events")


class Level(IntEnum):
    """Level of a status; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


_LEVEL_OF = {Severity.INFO: Level.OK, Severity.WARNING: Level.WARN, Severity.ERROR: Level.ERROR}


class Status(NamedTuple):
    """One part of the daemon; an aggregator sorts by its name, "arpd: link", and its values stand in order."""

    name: str
    level: Level
    message: str
    values: dict[str, str]


def diagnose(snapshot: Snapshot | None, *, now_s: float) -> tuple[Status, ...]:
    """Return all statuses; they are stale while no tick finishes, and before the first."""
    if snapshot is None:
        return tuple(Status(f"arpd: {part}", Level.STALE, "starting", {}) for part in _PARTS)
    situation = judge(snapshot, now_s=now_s)
    stale = next((each.text for each in situation.faults if each.condition is Condition.STALE), "")
    events = {
        f"{each.number}: {_time(each.unix_time_s)} {each.kind}": each.text
        for each in reversed(snapshot.events[-_MOST_EVENTS:])
    }
    facts = (_of_link(snapshot), _of_plan(snapshot, situation), _of_configuration(snapshot), events)
    return tuple(
        Status(f"arpd: {part}", *((Level.STALE, stale) if stale else _level(part, snapshot, situation, now_s)), values)
        for part, values in zip(_PARTS, facts, strict=True)
    )


def _level(part: str, snapshot: Snapshot, situation: Situation, now_s: float) -> tuple[Level, str]:
    """Return level and message of a part: those of its most important finding, or else a fact."""
    if part == "events":  # the worst one within a minute sets the level
        recent = (_LEVEL_OF[each.severity] for each in snapshot.events if now_s - each.at_s < _RECENT_S)
        return max(recent, default=Level.OK), snapshot.events[-1].text if snapshot.events else "nothing yet"
    if found := next((each for each in situation.findings if each.condition.part == part), None):
        return _LEVEL_OF[found.condition.severity], found.text
    return Level.OK, {
        "link": f"{format_rate(snapshot.link.capacity_bytes_per_second)}, {snapshot.link.state.words}",
        "plan": f"plan {snapshot.decision.plan.generation}: {who_confirmed(snapshot)}",
        "configuration": f"in force since {_time(snapshot.config_loaded_at_s)}",
    }[part]


def _of_link(snapshot: Snapshot) -> dict[str, str]:
    link, peers = snapshot.link, [*snapshot.observation.peer_ages_s.items()][:_MOST_PEERS]
    return {
        "interface": snapshot.interface,
        "capacity": format_rate(link.capacity_bytes_per_second),
        "known from": f"{link.kind}: {link.evidence}" if link.evidence else str(link.kind),
        "budget of topics": format_rate(snapshot.allocation.budget_bytes_per_second),
        "cross traffic": format_rate(link.cross_traffic_bytes_per_second),
        "queue delay": format_duration(link.queue_delay_s),
        "loss": "unknown" if link.loss_ratio is None else format_share(link.loss_ratio),
        "peers": ", ".join(f"{peer} ({format_duration(age_s)} ago)" for peer, age_s in peers) or "none",
    }


def _of_plan(snapshot: Snapshot, situation: Situation) -> dict[str, str]:
    decision, slowed = snapshot.decision, situation.slowed
    return {
        "plan": str(decision.plan.generation),
        "allowed above the minimum rates": format_share(decision.allowed),
        "publishers confirmed": f"{snapshot.confirmed} of {snapshot.managed}",
        **{
            f"{each.topic} of {each.node}": f"{format_number(each.allowed_hz)} of "
            f"{format_number(each.confirmed.source_rate_hz)} Hz"
            for each in slowed[:_MOST_TOPICS]
        },
        "further publishers slowed": str(max(0, len(slowed) - _MOST_TOPICS)),
    }


def _of_configuration(snapshot: Snapshot) -> dict[str, str]:
    return {
        "file": snapshot.config_path,
        "read at": _time(snapshot.config_loaded_at_s),
        "after a restart": ", ".join(snapshot.keys_awaiting_restart) or "nothing",
        "version": snapshot.version,
    }


def _time(unix_time_s: float) -> str:
    return datetime.fromtimestamp(unix_time_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
