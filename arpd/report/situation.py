"""The one judgement of the daemon: its link, its plan, its ticks and its configuration.

The decision log, ``systemctl status``, the page, ``arpd status``, ``arpd top`` and /diagnostics take conditions,
severities, words and thresholds from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Self

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.interface import state_of
from arpd.model.link import LinkState
from arpd.model.quantities import format_duration, format_number, format_rate, format_share
from arpd.model.settings import AUTO
from arpd.report import waiting
from arpd.report.events import EventKind, Severity
from arpd.report.topic_rows import topic_rows
from arpd.report.wording import AT_FLOORS, confirmed, count, listed, short

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Sequence

    from arpd.report.snapshot import Snapshot
    from arpd.report.topic_rows import TopicRow

STALE_AFTER_S = 3.0  # ticks are 0.1 s apart
UNCONFIRMED_AFTER_S = 15.0  # a swap proves itself within seconds, and arpd tries again
SLOWED_BELOW = 0.95  # of what the source publishes; a rate within a twentieth of it slows nobody
_DRAINS_BELOW = 0.5  # of what is usable; a budget above this follows the link, and does not drain a queue
_LEAST_BUDGET = 0.001  # of the capacity; less is nothing to people
_STEPS = 20  # of the admitted part in the line for systemd, which sends each change to everybody who watches
_EMPTY_QUEUE_S = 0.001
_LOSSY = 0.01
_OF_THE_LINK = {Binding.LINK, Binding.FLOOR}
_PLAN_BEGINS = {EventKind.PLAN, EventKind.MEMORY, EventKind.TOPIC_FOUND}


class Condition(StrEnum):
    """A condition of the daemon: of link and plan, the most important first; then faults beside it, the worst first.

    Attributes
    ----------
    severity : of a finding, and of the event that begins the condition
    headline : a few words that stay the same while the condition does
    is_wrong : True where somebody should look: `arpd status` exits 1
    """

    severity: Severity
    headline: str
    is_wrong: bool

    STANDING_BY = "standing_by", Severity.WARNING, "Standing by", True
    INTERFACE_ABSENT = "interface_absent", Severity.WARNING, "The link is down", True  # it was never there
    INTERFACE_DOWN = "interface_down", Severity.ERROR, "The link is down", True
    OUTAGE = "outage", Severity.ERROR, "The link carries nothing", True
    MEASURING = "measuring", Severity.INFO, "No plan yet", False
    NOTHING_TO_GOVERN = "nothing_to_govern", Severity.INFO, "Nothing to govern", False
    DEGRADED = "degraded", Severity.WARNING, "Not everything asked for fits", True
    OVERFULL = "overfull", Severity.WARNING, "The link is overfull", False
    LIMITED = "limited", Severity.WARNING, "The link is the limit", False
    CLEAR = "clear", Severity.INFO, "The link is fine", False
    STALE = "stale", Severity.ERROR, "No tick finishes", True
    RELOAD_REFUSED = "reload_refused", Severity.ERROR, "Reload refused", True
    RELAY_SILENT = "relay_silent", Severity.ERROR, "The relay on the robot is silent", True
    RELAY_CUT = "relay_cut", Severity.WARNING, "The relay's ends do not meet", True
    RELAY_REFUSES = "relay_refuses", Severity.WARNING, "The relay refuses topics", True
    UNCONFIRMED = "unconfirmed", Severity.WARNING, "Plan not confirmed", True
    RESTART_NEEDED = "restart_needed", Severity.WARNING, "Restart needed", False
    WITHOUT_PEER = "without_peer", Severity.INFO, "No peer reports", False

    def __new__(cls, name: str, severity: Severity, headline: str, is_wrong: bool) -> Self:  # noqa: FBT001 - the table above names none
        """Return a member: its name in documents, and its attributes."""
        condition = str.__new__(cls, name)
        condition._value_ = name
        condition.severity, condition.headline, condition.is_wrong = severity, headline, is_wrong
        return condition

    @property
    def phrase(self) -> str:
        """The headline inside a sentence."""
        return self.headline[0].lower() + self.headline[1:]


_WAITS = {Condition.MEASURING, Condition.NOTHING_TO_GOVERN}


@dataclass(frozen=True, slots=True)
class Finding:
    """A condition that holds, and the reason.

    Parameters
    ----------
    why : what follows the headline, without a full stop
    """

    condition: Condition
    why: str

    @property
    def text(self) -> str:
        """The whole sentence, headline first."""
        return f"{self.condition.headline}: {self.why}."

    @property
    def phrase(self) -> str:
        """The same, for a line that goes on."""
        return f"{self.condition.phrase}: {self.why}"


class Slowed(NamedTuple):
    """A topic that the link keeps below the rate of its source (Hz); ``kept`` is the part that is left."""

    kept: float
    topic: str
    rate_hz: float
    source_hz: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Situation:
    """A snapshot, judged.

    Parameters
    ----------
    conditions : of link and plan, at least one, the most important first
    faults : of ticks, configuration, relay, publishers and peers, the worst first
    slowed : topics that the link keeps below their sources' rates, the most slowed first
    """

    conditions: tuple[Finding, ...]
    faults: tuple[Finding, ...]
    slowed: tuple[Slowed, ...]

    @property
    def verdict(self) -> Finding:
        """The condition that matters most."""
        return self.conditions[0]

    def first_of(self, conditions: Container[Condition]) -> Finding | None:
        """Return the most important finding among the given conditions, None where none of them holds."""
        found = (*self.conditions, *self.faults)
        return next((finding for finding in found if finding.condition in conditions), None)


def judge(snapshot: Snapshot, *, rows: Sequence[TopicRow] | None = None, now_s: float | None = None) -> Situation:
    """Judge a snapshot.

    Parameters
    ----------
    rows : its live publishers as `topic_rows` returns them, by default from the snapshot
    now_s : monotonic clock (s), to find ticks that do not finish
    """
    rows = topic_rows(snapshot) if rows is None else rows
    slowed = slowed_topics(rows)
    return Situation(
        conditions=tuple(_conditions(snapshot, sum(row.planned is not None for row in rows), slowed)),
        faults=tuple(_faults(snapshot, now_s)),
        slowed=slowed,
    )


def slowed_topics(rows: Iterable[TopicRow]) -> tuple[Slowed, ...]:
    """Return the topics that the link keeps below their sources' rates now, the most slowed first."""
    return tuple(
        sorted(
            Slowed(kept, row.publisher.topic, row.allocation.rate_hz, row.publisher.source_rate_hz)
            for row in rows
            if row.allocation is not None and (kept := kept_ratio(row)) < SLOWED_BELOW
        )
    )


def kept_ratio(row: TopicRow) -> float:
    """Return the part of its source's rate that the link leaves a topic now; 1 where the link does not slow it."""
    source_hz, allocation = row.publisher.source_rate_hz, row.allocation
    if row.planned is None or allocation is None or source_hz <= 0 or allocation.binding not in _OF_THE_LINK:
        return 1.0
    return min(1.0, allocation.rate_hz / source_hz)


def _is_draining(snapshot: Snapshot) -> bool:
    """Return whether a queue stands, or arpd leaves the topics little until one has gone."""
    link = snapshot.link
    if link.state in {LinkState.CONGESTED, LinkState.DRAINING}:
        return True
    # The level knows the headroom, and the estimate knows the link of this moment.
    usable = min(snapshot.decision.plan.level_bytes_per_second, link.available_bytes_per_second)
    return snapshot.allocation.capacity_bytes_per_second < _DRAINS_BELOW * usable


def _conditions(snapshot: Snapshot, planned: int, slowed: Sequence[Slowed]) -> Iterator[Finding]:
    if (other := standing_by(snapshot)) is not None:
        yield other
    if (fault := interface_fault(snapshot)) is not None:
        condition, what = fault
        is_absent = condition is Condition.INTERFACE_ABSENT
        where = "; compare link.interface with what ip link lists" if is_absent else ""
        yield Finding(condition, f"{what}; arpd goes on by itself when that changes{where}")
    elif snapshot.link.state is LinkState.OUTAGE:
        yield Finding(Condition.OUTAGE, f"{AT_FLOORS} until packets arrive again")
    elif other is None:
        yield from _governing(snapshot, planned, slowed) if planned else (_without_plan(snapshot),)


def _governing(snapshot: Snapshot, planned: int, slowed: Sequence[Slowed]) -> Iterator[Finding]:
    allocation = snapshot.allocation
    if allocation.status is AllocationStatus.DEGRADED:
        yields = f"arpd gives up the least important first ({allocation.degradation})"
        yield Finding(Condition.DEGRADED, f"{_budget(snapshot)}, and {yields}; {_effect(snapshot)}")
    if _is_draining(snapshot):
        yield Finding(Condition.OVERFULL, f"{_queue(snapshot)}; {_budget(snapshot)} until the queue is short")
    if not slowed:
        carries = format_rate(snapshot.link.capacity_bytes_per_second)
        why = f"{carries} is more than the robot offers; arpd slows none of {count(planned, 'topic')}"
        yield Finding(Condition.CLEAR, f"{why}; {_unmeasured(snapshot) or _queue_and_loss(snapshot)}")
        return
    _, most, rate_hz, source_hz = slowed[0]
    rates = f"{format_number(source_hz)} → {format_number(rate_hz)} Hz"
    slows = f"arpd slows {len(slowed)} of {count(planned, 'topic')}, {most} most ({rates})"
    yield Finding(Condition.LIMITED, f"{_budget(snapshot)}, and the robot offers more; {slows}; {_effect(snapshot)}")


def _budget(snapshot: Snapshot) -> str:
    """Say what the topics may use now."""
    budget, capacity = snapshot.allocation.capacity_bytes_per_second, snapshot.link.capacity_bytes_per_second
    if budget < _LEAST_BUDGET * capacity:
        return f"topics may use next to nothing of {format_rate(capacity)}"
    return f"topics may use {format_rate(budget)} of {format_rate(capacity)}"


def _without_plan(snapshot: Snapshot) -> Finding:
    if any(publisher.direction != "local" for publisher in snapshot.observation.publishers):
        return Finding(Condition.MEASURING, waiting.first_plan(snapshot))
    return Finding(Condition.NOTHING_TO_GOVERN, waiting.topics(snapshot))


def _faults(snapshot: Snapshot, now_s: float | None = None) -> Iterator[Finding]:
    if now_s is not None and (age_s := now_s - snapshot.finished_at_s) > STALE_AFTER_S:
        yield stale(age_s)
    if snapshot.config_error:
        yield reload_refused(snapshot)
    yield from _relay_faults(snapshot)
    if (waited_s := _unconfirmed_s(snapshot)) > UNCONFIRMED_AFTER_S:
        # In whole seconds: the status line goes to systemd whenever it changes.
        yield Finding(Condition.UNCONFIRMED, f"{who_confirmed(snapshot)} after {format_duration(waited_s // 1)}")
    if keys := snapshot.keys_awaiting_restart:
        why = f"the file's {listed(keys)} {'is' if len(keys) == 1 else 'are'} not in force"
        yield Finding(Condition.RESTART_NEEDED, why)
    is_cut = snapshot.link.state is LinkState.OUTAGE or interface_fault(snapshot) is not None
    if not is_cut and standing_by(snapshot) is None and (why := waiting.peer(snapshot)):
        yield Finding(Condition.WITHOUT_PEER, why)


def _relay_faults(snapshot: Snapshot) -> Iterator[Finding]:
    relay = snapshot.observation.relay
    if snapshot.observation.is_relay_silent:
        start = "start it: sudo systemctl enable --now arpd-relay"
        yield Finding(Condition.RELAY_SILENT, f"it tells this daemon nothing; {start}; or see journalctl -u arpd-relay")
    if relay is None:
        return
    if relay.fault:
        yield Finding(Condition.RELAY_CUT, f"the base computer's end is not understood: {relay.fault}")
    elif not relay.is_reachable and snapshot.link.state is not LinkState.OUTAGE:
        who = (
            f"the base computer's end on {relay.other_host} is silent"
            if relay.other_host
            else "no end on the base computer is heard"
        )
        start = "start it there: sudo systemctl enable --now arpd-relay-far"
        yield Finding(Condition.RELAY_CUT, f"{who}, so no topic crosses; {start}; or see its journal")
    if refused := {**relay.to_robot.refused, **relay.to_base.refused}:
        first, *more = sorted(refused)
        also = f"; also {listed(more)}" if more else ""
        yield Finding(Condition.RELAY_REFUSES, f"{short(first)}: {refused[first]}{also}")


def reload_refused(snapshot: Snapshot) -> Finding:
    """Return the finding for a refused reload."""
    return Finding(Condition.RELOAD_REFUSED, f"{snapshot.config_error} (the configuration in force stays)")


def stale(age_s: float) -> Finding:
    """Return the finding for a last tick that finished so long ago (s)."""
    why = f"the last one finished {format_duration(age_s)} ago; publishers keep the price and the plan they have"
    return Finding(Condition.STALE, why)


def who_confirmed(snapshot: Snapshot) -> str:
    """Say how many publishers run the plan in force."""
    return confirmed(confirmed=snapshot.confirmed, publishers=snapshot.managed)


def _unconfirmed_s(snapshot: Snapshot) -> float:
    """Return for how long publishers do not follow the plan (s); 0 where the decision log does not say."""
    if snapshot.confirmed >= snapshot.managed:
        return 0.0
    began = None
    for began in reversed(snapshot.events):
        if began.kind is EventKind.CONFIRMED:
            return 0.0
        if began.kind in _PLAN_BEGINS:
            break
    return 0.0 if began is None else snapshot.unix_time_s - began.unix_time_s


def _effect(snapshot: Snapshot) -> str:
    """Say whether a decision helped: it did when little queues and little is lost."""
    link = snapshot.link
    if without := _unmeasured(snapshot):
        return without
    helps = link.queue_delay_s <= link.queue_allowance_s and (link.loss_ratio or 0.0) <= _LOSSY
    return f"{'it helps' if helps else 'it does not help yet'}: {_queue_and_loss(snapshot)}"


def _unmeasured(snapshot: Snapshot) -> str:
    """Say that nobody measures the link, empty where a peer does."""
    if waiting.is_reported(snapshot):
        return ""
    return "no peer reports, so the capacity is a guess and nobody measures the queue"


def _queue_and_loss(snapshot: Snapshot) -> str:
    loss = snapshot.link.loss_ratio or 0.0
    return f"{_queue(snapshot)} and {format_share(loss)} loss" if loss > _LOSSY else _queue(snapshot)


def _queue(snapshot: Snapshot) -> str:
    delay_s = snapshot.link.queue_delay_s
    if not math.isfinite(delay_s):
        return "a queue of unknown length"
    return f"{format_duration(delay_s)} of queue" if delay_s >= _EMPTY_QUEUE_S else "no queue"


def standing_by(snapshot: Snapshot) -> Finding | None:
    """Return the finding for a robot that another daemon drives, None where this one drives it."""
    if not (where := snapshot.observation.active_daemon):
        return None
    why = f"another arpd daemon, on {where}, drives this robot"
    return Finding(Condition.STANDING_BY, why)


def interface_fault(snapshot: Snapshot) -> tuple[Condition, str] | None:
    """Return why the link interface carries nothing, None when it can carry."""
    if not (fault := state_of(snapshot.observation.counters).fault):
        return None
    if snapshot.has_interface:
        return Condition.INTERFACE_DOWN, f"{snapshot.interface} {fault}"
    what = "no link interface is there yet" if snapshot.interface == AUTO else f"{snapshot.interface} is not there yet"
    return Condition.INTERFACE_ABSENT, what


def status_line(snapshot: Snapshot | None) -> str:
    """Return one line for ``systemctl status``; rates are rounded, so that it changes rarely."""
    if snapshot is None:
        return "starting"
    if (other := standing_by(snapshot)) is not None:
        return other.phrase
    link, decision = snapshot.link, snapshot.decision
    line = (
        f"{link.capacity_bytes_per_second * 8e-6:.1f} Mbit/s ({link.kind}, {link.state}, "
        f"{link.cross_traffic_bytes_per_second * 8e-6:.1f} cross traffic), "
        f"admitted {format_share(round(decision.gate * _STEPS) / _STEPS)}, "
        f"plan {decision.plan.generation}: {confirmed(confirmed=snapshot.confirmed, publishers=snapshot.managed)}"
    )
    _, fault = interface_fault(snapshot) or (None, "")
    # Judged at each turn only while nothing is planned: a judgement reads every topic.
    unplanned = None if snapshot.managed else judge(snapshot)
    if unplanned is not None and unplanned.verdict.condition in _WAITS:
        line = unplanned.verdict.phrase
    faults = _faults(snapshot) if unplanned is None else unplanned.faults
    return "; ".join(said for said in (fault, line, *(finding.phrase for finding in faults)) if said)
