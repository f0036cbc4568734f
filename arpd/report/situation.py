"""One sentence for whoever has ten seconds: whether the link is the problem, what arpd did and why, and if it helps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.interface import state_of
from arpd.model.link import LinkState
from arpd.model.quantities import format_duration, format_rate
from arpd.model.settings import AUTO
from arpd.report.events import Severity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.report.snapshot import Snapshot
    from arpd.report.topic_rows import TopicRow

_SLOWED = 0.95  # a plan within a twentieth of what the application publishes slows nobody
_OPEN = 0.8  # a gate above this trims, and does not drain
_NOTHING_S = 0.001
_OF_THE_LINK = {Binding.LINK, Binding.FLOOR}
_LOSSY = 0.01
_REPORTED_S = 5.0  # a peer that lives reports every second or two


class Verdict(NamedTuple):
    """What a snapshot comes to.

    Parameters
    ----------
    severity : how much it matters
    headline : a few words that stay the same while the situation does
    text : the whole sentence, headline first
    """

    severity: Severity
    headline: str
    text: str


def verdict(snapshot: Snapshot, rows: Sequence[TopicRow]) -> Verdict:
    """Judge a snapshot.

    Parameters
    ----------
    rows : its live publishers, with what the plan and the program say of each
    """
    planned = [row for row in rows if row.planned is not None]
    if active_daemon := snapshot.observation.active_daemon:
        return _said(Severity.WARNING, "Standing by", f"another arpd daemon, on {active_daemon}, drives this robot")
    return _down(snapshot) or (_planned(snapshot, planned) if planned else _without_plan(snapshot))


def _down(snapshot: Snapshot) -> Verdict | None:
    if fault := state_of(snapshot.observation.counters).fault:
        why = f"{snapshot.interface} {fault}, so that nothing can cross it; arpd goes on by itself when that changes"
        return _said(Severity.ERROR, "The link is down", why)
    if snapshot.link.state is LinkState.OUTAGE:
        return _said(
            Severity.ERROR,
            "The link is down",
            "nothing of the peer arrives; arpd holds every topic at its lowest rate, and raises them when it is back",
        )
    return None


def _planned(snapshot: Snapshot, planned: Sequence[TopicRow]) -> Verdict:
    if snapshot.allocation.status is AllocationStatus.DEGRADED:
        given_up = f"arpd gives up the least important first ({snapshot.allocation.degradation})"
        why = f"the link carries {_capacity(snapshot)}, and {given_up}"
        return _said(Severity.WARNING, "Not everything asked for fits", f"{why}; {_effect(snapshot)}")
    if snapshot.link.state in {LinkState.CONGESTED, LinkState.DRAINING} or snapshot.decision.gate < _OPEN:
        return _said(
            Severity.WARNING,
            "The link is overfull",
            f"{_queue(snapshot)} at {_capacity(snapshot)}; arpd lets {_percent(snapshot.decision.gate)} of the planned "
            "rates pass until it has drained",
        )
    return _settled(snapshot, planned)


def _settled(snapshot: Snapshot, planned: Sequence[TopicRow]) -> Verdict:
    """Judge a link that neither fails nor queues: either it limits somebody, or it does not."""
    slowed = sorted((row for row in planned if _ratio(row) < _SLOWED), key=_ratio)
    if not slowed:
        room = f"{_capacity(snapshot)} is more than the robot offers; arpd slows none of {_topics(len(planned))}"
        return _said(Severity.INFO, "The link is fine", f"{room}; {_effect(snapshot, is_help=False)}")
    most = slowed[0]
    assert most.planned is not None
    rates = f"{_hz(most.publisher.source_rate_hz)} → {_hz(most.planned.rate_hz)} Hz"
    decided = f"arpd slowed {len(slowed)} of {_topics(len(planned))}, {most.publisher.topic} most ({rates})"
    waiting = len(planned) - snapshot.confirmed
    unconfirmed = f", and {waiting} of them {'has' if waiting == 1 else 'have'} yet to confirm" if waiting > 0 else ""
    return _said(
        Severity.WARNING,
        "The link is the limit",
        f"{_capacity(snapshot)} is less than the robot offers; {decided}{unconfirmed}; {_effect(snapshot)}",
    )


def _without_plan(snapshot: Snapshot) -> Verdict:
    crossing = [p for p in snapshot.observation.publishers if p.direction != "local"]
    if not snapshot.observation.publishers:
        why = "no publisher has announced itself; use arpd.AdaptivePublisher, or name topics under relay.topics"
    elif not crossing:
        why = "no announced topic has a reader on the other side of the link"
    else:
        return _said(Severity.INFO, "No plan yet", f"arpd is still measuring the link for {_topics(len(crossing))}")
    return _said(Severity.INFO, "Nothing to govern", why)


def _effect(snapshot: Snapshot, *, is_help: bool = True) -> str:
    """Say whether it helped: a decision helps when nothing queues and nothing is lost."""
    link = snapshot.link
    if not _is_reported(snapshot):
        return "no peer reports, so that the capacity is a guess and nobody measures the queue"
    loss = link.loss_ratio or 0.0
    lost = f" and {_percent(loss)} loss" if loss > _LOSSY else ""
    is_good = link.queue_delay_s <= link.queue_allowance_s and not lost
    if not is_help:
        return f"{_queue(snapshot)}{lost}"
    return f"{'it helps' if is_good else 'it does not help yet'}: {_queue(snapshot)}{lost}"


def _is_reported(snapshot: Snapshot) -> bool:
    """Whether a peer tells what the link delivers."""
    return min(snapshot.observation.peer_ages_s.values(), default=math.inf) < _REPORTED_S


def _queue(snapshot: Snapshot) -> str:
    delay_s = snapshot.link.queue_delay_s
    if not math.isfinite(delay_s):
        return "a queue nobody measures"
    return f"{format_duration(delay_s)} of queue" if delay_s >= _NOTHING_S else "no queue"


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f} %"


def _capacity(snapshot: Snapshot) -> str:
    return format_rate(snapshot.link.capacity_bytes_per_second)


def _ratio(row: TopicRow) -> float:
    """Planned over published by the application; 1 where something other than the link set the rate."""
    source_hz, planned, allocation = row.publisher.source_rate_hz, row.planned, row.allocation
    if planned is None or allocation is None or source_hz <= 0 or allocation.binding not in _OF_THE_LINK:
        return 1.0
    return min(1.0, planned.rate_hz / source_hz)


def _topics(count: int) -> str:
    return f"{count} {'topic' if count == 1 else 'topics'}"


def _hz(rate_hz: float) -> str:
    return "unpaced" if math.isinf(rate_hz) else f"{rate_hz:.3g}"


def _said(severity: Severity, headline: str, rest: str) -> Verdict:
    return Verdict(severity, headline, f"{headline}: {rest}.")


def status_line(snapshot: Snapshot | None) -> str:
    """One line a human can read, for ``systemctl status``."""
    if snapshot is None:
        return "starting"
    if active_daemon := snapshot.observation.active_daemon:
        return f"standing by: another arpd daemon, on {active_daemon}, drives this robot"
    link, decision = snapshot.link, snapshot.decision
    line = (
        f"{link.capacity_bytes_per_second * 8e-6:.1f} Mbit/s ({link.kind}, {link.state}, "
        f"{link.cross_traffic_bytes_per_second * 8e-6:.1f} foreign), "
        f"gate {decision.gate:.2f}, plan {decision.plan.generation}: "
        f"{snapshot.confirmed} of {snapshot.managed} publishers confirmed"
    )
    refused = f"reload refused: {snapshot.config_error}" if snapshot.config_error else ""
    awaiting = snapshot.keys_awaiting_restart
    waiting = f"restart needed for {', '.join(awaiting[:3])}" if awaiting else ""
    if (more := len(awaiting) - 3) > 0:
        waiting += f" and {more} more"
    return "; ".join(said for said in (_interface_fault(snapshot), line, refused, waiting) if said)


def _interface_fault(snapshot: Snapshot) -> str:
    """Say why the link interface carries nothing, empty when it does."""
    fault = state_of(snapshot.observation.counters).fault
    if not fault:
        return ""
    if snapshot.has_interface:
        return f"{snapshot.interface} {fault}"
    return "no link interface is there yet" if snapshot.interface == AUTO else f"{snapshot.interface} is not there yet"
