"""What a status document comes to: the daemon's own verdict, and whether somebody should look."""

from __future__ import annotations

from typing import Any

from arpd.cli.client import count, number, rows, text
from arpd.model.quantities import format_duration
from arpd.report.status import confirmed, interface_fault

_STALE_S = 5.0  # ticks are 0.1 s apart
_CONFIRMED_WITHIN_S = 15.0  # a swap is proven within seconds, and the planner tries again
# Values as the document spells them; to import the enums costs more than all else here.
_LINK_BINDINGS = {"link", "floor"}
_OUTAGE, _DEGRADED = "outage", "degraded"
_PLAN_BEGINS, _PLAN_CONFIRMED = {"plan", "topic_found"}, "confirmed"
_HELD_BACK = 0.95  # of what its source publishes, as `arpd.report.situation` has it


def verdict(status: dict[str, Any]) -> str:
    """Return the daemon's sentence on whether the link is the limit and arpd copes; an older one has none."""
    return text(status, "verdict", "text")


def faults(status: dict[str, Any]) -> list[str]:
    """Say what is wrong, worst first; empty when arpd governs and all is well."""
    if not status.get("ready"):
        return ["not ready: it has not finished a tick, or does not govern yet"]
    found = []
    if (age_s := number(status, "age_seconds") or 0.0) > _STALE_S:
        found.append(f"no tick has finished for {format_duration(age_s)}; publishers keep the plan they have")
    if failing := _failing(status):
        found.append(verdict(status) or failing)
    if error := text(status, "config", "error"):
        found.append(f"the last reload was refused: {error}")
    if (waiting_s := _unconfirmed_s(status)) > _CONFIRMED_WITHIN_S:
        found.append(f"plan not confirmed for {format_duration(waiting_s)}: {who_confirmed(status)}")
    return found


def is_held_back(topic: dict[str, Any]) -> bool:
    """Whether the link, and not its configuration, keeps a topic below what its source publishes."""
    return text(topic, "binding") in _LINK_BINDINGS and kept_ratio(topic) < _HELD_BACK


def kept_ratio(topic: dict[str, Any]) -> float:
    """Return which part of what its source publishes the plan lets through; 1 where one of the two is not known."""
    planned, source = number(topic, "planned", "rate_hz"), number(topic, "source_rate_hz")
    return 1.0 if planned is None or not source else min(1.0, planned / source)


def who_confirmed(status: dict[str, Any]) -> str:
    """Say who announces the plan in force."""
    known = ("confirmed", "publishers", "paced_only", "readers", "readers_confirmed")
    return f"{confirmed({name: count(status, 'plan', name) for name in known})} confirmed"


def _failing(status: dict[str, Any]) -> str:
    """Say why arpd cannot do what it is for: what the verdict of a newer daemon says in its own words."""
    if active_daemon := text(status, "daemons", "standing_by_for"):
        return f"standing by: another arpd daemon, on {active_daemon}, drives this robot"
    if fault := interface_fault({"interface_state": text(status, "interface_state") or "up"}):
        return f"{text(status, 'interface')} {fault}"
    if text(status, "link", "state") == _OUTAGE:
        return "nothing comes through the link"
    if text(status, "allocation", "status") == _DEGRADED:
        return f"not everything asked for fits; given up: {text(status, 'allocation', 'degradation')}"
    return ""


def _unconfirmed_s(status: dict[str, Any]) -> float:
    """How long publishers or readers have not followed the plan (s); 0 where the decision log does not tell."""
    missing = count(status, "plan", "publishers") - count(status, "plan", "confirmed")
    missing += count(status, "plan", "readers") - count(status, "plan", "readers_confirmed")
    events, now_s = rows(status, "events"), number(status, "unix_time_seconds")
    if missing <= 0 or not events or now_s is None:
        return 0.0
    since_s: float | None = number(events[0], "unix_time_seconds")
    for event in events:
        if (kind := text(event, "event")) in _PLAN_BEGINS:
            since_s = number(event, "unix_time_seconds")
        elif kind == _PLAN_CONFIRMED:
            since_s = None
    return 0.0 if since_s is None else now_s - since_s
