"""The one judgement of the daemon: which conditions hold, and why."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.endpoints import MOST_PUBLISHERS
from arpd.model.interface import state_of
from arpd.model.link import LinkState
from arpd.model.quantities import format_duration, format_number, format_rate, format_share
from arpd.model.settings import AUTO, RelaySettings
from arpd.report import waiting
from arpd.report.conditions import Condition, Finding
from arpd.report.topic_rows import Topic, topic_rows
from arpd.report.wording import confirmed, count, joined, listed, short

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from arpd.model.relay import RelaySummary
    from arpd.report.snapshot import Snapshot

_DRAINS_BELOW = 0.5  # of what is usable; a budget above this follows the link, and does not drain a queue
_MUCH_CROSS = 0.1  # of the capacity; what is less explains little
_LEAST_BUDGET = 0.001  # of the capacity; less is nothing to people
_STEPS = 20  # of the allowed part in the line for systemd, which sends each change to everybody who watches
_EMPTY_QUEUE_S = 0.001
_LOSSY = 0.01
_RANK = {condition: number for number, condition in enumerate(Condition)}
_CUTS = {Condition.STANDING_BY, Condition.INTERFACE_DOWN, Condition.OUTAGE}
# What nobody can know while the link is cut or another daemon drives the robot: it neither begins nor ends.
HIDDEN_WHILE_CUT = {
    Condition.OUTAGE,  # while the interface is down, or no peer answers this daemon, because it asks nothing
    Condition.PEER_LOST,
    Condition.MINIMUM_RATES,
    Condition.RELAY_SILENT,  # its messages to this daemon wait behind those for a link that stands still
    Condition.RELAY_CUT,
    Condition.UNCONFIRMED,
    Condition.WITHOUT_PEER,
    Condition.POSTPONED,
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Situation:
    """A snapshot, judged.

    Parameters
    ----------
    findings : all that holds: of link and plan at least one, the most important first, then faults, the worst first
    slowed : topics that the link keeps below their sources' rates, the most slowed first
    """

    findings: tuple[Finding, ...]
    slowed: tuple[Topic, ...]

    @property
    def verdict(self) -> Finding:
        """The condition that matters most."""
        return self.findings[0]

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Those of ticks, configuration, relay, publishers and peers."""
        return tuple(filter(_is_fault, self.findings))


def judge(snapshot: Snapshot, *, rows: Sequence[Topic] | None = None, now_s: float | None = None) -> Situation:
    """Judge a snapshot.

    Parameters
    ----------
    rows : its live publishers as `topic_rows` returns them, by default from the snapshot
    now_s : monotonic clock (s), to find ticks that do not finish
    """
    rows = topic_rows(snapshot) if rows is None else rows
    slowed = slowed_topics(rows)
    found = lasting(snapshot)
    if not _CUTS & {finding.condition for finding in found}:
        found += _course(snapshot, rows, slowed)
    if now_s is not None and (age_s := now_s - snapshot.finished_at_s) > Condition.STALE.holds_s:
        why = f"the last one finished {format_duration(age_s)} ago; publishers keep the price and the plan they have"
        found.append(Finding(Condition.STALE, why))
    return Situation(findings=tuple(sorted(found, key=lambda finding: _RANK[finding.condition])), slowed=slowed)


def _is_fault(finding: Finding) -> bool:
    return _RANK[finding.condition] > _RANK[Condition.CLEAR]


def lasting(snapshot: Snapshot) -> list[Finding]:
    """Return the events among the conditions that have held for their time."""
    return [each for each in snapshot.found if snapshot.finished_at_s - each.since_s >= each.condition.holds_s]


def find(snapshot: Snapshot) -> tuple[Finding, ...]:
    """Return those conditions that are events, however short, since when the snapshot before knew them.

    No wall clock has a say.
    """
    return tuple(
        each if math.isfinite(each.since_s) else replace(each, since_s=_since_s(snapshot, each))
        for each in _found_in(snapshot)
    )


def _since_s(snapshot: Snapshot, finding: Finding) -> float:
    before = (
        each.since_s for each in snapshot.found if (each.condition, each.about) == (finding.condition, finding.about)
    )
    return next(before, snapshot.finished_at_s)


def _found_in(snapshot: Snapshot) -> Iterator[Finding]:
    observation = snapshot.observation
    if where := observation.active_daemon:
        domain = "a relay.link_domain" if observation.relay else "a ROS domain"
        remedy = f"end it if it is this robot's, else give each robot {domain} of its own"
        yield Finding(Condition.STANDING_BY, f"another arpd daemon, on {where}, drives this robot; {remedy}")
    elif others := observation.other_daemons:
        yield Finding(Condition.SPARE_DAEMON, f"on {listed(others)}, in the same ROS domain")
    if fault := _interface_fault(snapshot):
        yield Finding(Condition.INTERFACE_DOWN, f"{fault}; arpd goes on by itself when that changes", fault)
    elif snapshot.link.state is LinkState.OUTAGE and not observation.active_daemon:
        yield Finding(Condition.OUTAGE, "no topic sends more than its minimum rate until packets arrive again")
    yield from _of_configuration(snapshot)
    yield from _of_relay(snapshot)
    if left_out := observation.left_out:
        nodes, many = sorted(left_out), sum(left_out.values())
        why = f"{count(many, 'publisher')} of {listed(nodes)} {'has' if many == 1 else 'have'} no plan"
        yield Finding(Condition.LEFT_OUT, f"{why}, because arpd manages {MOST_PUBLISHERS} at most", " ".join(nodes))
    if not observation.active_daemon and (why := waiting.peer(snapshot)):
        if waiting.is_lost(snapshot):  # one that is forgotten is so since it was found
            silent_s = min(observation.peer_ages_s.values(), default=-math.inf)
            yield Finding(Condition.PEER_LOST, why, since_s=snapshot.finished_at_s - silent_s)
        elif not is_cut(snapshot):
            yield Finding(Condition.WITHOUT_PEER, why)
    if not is_cut(snapshot):
        yield from _of_far_side(snapshot)


def is_cut(snapshot: Snapshot) -> bool:
    """Return whether the link carries nothing, or another daemon drives the robot."""
    is_down = state_of(snapshot.observation.counters).fault or snapshot.link.state is LinkState.OUTAGE
    return bool(is_down or snapshot.observation.active_daemon)


def _interface_fault(snapshot: Snapshot) -> str:
    """Say why the link interface carries nothing, empty when it can carry."""
    if not (fault := state_of(snapshot.observation.counters).fault):
        return ""
    if snapshot.has_interface:
        return f"{snapshot.interface} {fault}"
    what = "no link interface is there yet" if snapshot.interface == AUTO else f"{snapshot.interface} is not there yet"
    elsewhere = "" if snapshot.link.state is LinkState.OUTAGE else ", and the peer answers over another one"
    return f"{what}{elsewhere}; compare link.interface with what ip link lists"


def _of_configuration(snapshot: Snapshot) -> Iterator[Finding]:
    if error := snapshot.config_error:
        yield Finding(Condition.RELOAD_REFUSED, f"{error} (the configuration in force stays)", error)
    if keys := snapshot.keys_awaiting_restart:
        names = listed(keys)
        why = f"the file's {names} {'is' if len(keys) == 1 else 'are'} not in force"
        yield Finding(Condition.RESTART_NEEDED, why, names)


def _of_relay(snapshot: Snapshot) -> Iterator[Finding]:
    relay = snapshot.observation.relay
    if snapshot.observation.is_relay_silent and not is_cut(snapshot):
        start = "start it: sudo systemctl enable --now arpd-relay"
        yield Finding(Condition.RELAY_SILENT, f"it tells this daemon nothing; {start}; or see journalctl -u arpd-relay")
    if relay is None:
        return
    if not is_cut(snapshot) and (why := _why_cut(relay, snapshot.settings.relay)):
        yield Finding(Condition.RELAY_CUT, why)
    if refused := {**relay.to_robot.refused, **relay.to_base.refused}:
        first, *more = sorted(refused)
        also = f"; also {listed(more)}" if more else ""
        yield Finding(Condition.RELAY_REFUSES, f"{short(first)}: {refused[first]}{also}", " ".join(sorted(refused)))


def _why_cut(relay: RelaySummary, settings: RelaySettings) -> str:
    if relay.fault:
        return f"the base computer's end cannot be used: {relay.fault}"
    if relay.is_reachable:
        return ""
    see = "start it there: sudo systemctl enable --now arpd-relay-far; or see its journal"
    if relay.other_host:
        return f"the base computer's end on {relay.other_host} is silent, so no topic crosses; {see}"
    first, last = settings.ports
    firewall = f"a firewall must let UDP ports {first} to {last} in, on both computers"
    ends = {"robot": settings.robot, "base": settings.base}
    named = joined([f"{each} (relay.{key})" for key, each in ends.items() if each])
    heard = f"is heard in ROS domain {settings.link_domain} (relay.link_domain)"
    return f"no end on the base computer {heard}, so no topic crosses; {see}; {firewall}; check the address {named}"


def _of_far_side(snapshot: Snapshot) -> Iterator[Finding]:
    """Yield what can be known only over a link that carries."""
    allocation, decision = snapshot.allocation, snapshot.decision
    if allocation.status is AllocationStatus.DEGRADED and snapshot.managed:
        yields = f"arpd gives up the least important first ({allocation.degradation})"
        is_memory = allocation.binding is Binding.MEMORY
        why = "memory for histories is short (program.memory_budget)" if is_memory else _budget(snapshot)
        yield Finding(Condition.MINIMUM_RATES, f"{why}, and {yields}; {_effect(snapshot)}")
    if snapshot.confirmed < (managed := snapshot.managed):
        late = Finding(Condition.UNCONFIRMED, "", f"plan {decision.plan.generation} for {managed}")
        # In whole seconds: the status line goes to systemd whenever it changes.
        after = format_duration((snapshot.finished_at_s - _since_s(snapshot, late)) // 1)
        yield replace(late, why=f"{who_confirmed(snapshot)} after {after}")
    if decision.is_postponed:
        why = "limit reached: swaps have used up their part of the link"
        yield Finding(Condition.POSTPONED, why, f"plan {decision.plan.generation}")


def _course(snapshot: Snapshot, rows: Sequence[Topic], slowed: Sequence[Topic]) -> Iterator[Finding]:
    """Yield what the link is like, and what arpd does about it: as it changes from tick to tick, it is no event."""
    if not (planned := len({row.topic for row in rows if row.planned})):
        is_found = any(publisher.direction != "local" for publisher in snapshot.observation.publishers)
        if is_found:
            yield Finding(Condition.MEASURING, waiting.first_plan(snapshot))
        else:
            yield Finding(Condition.NOTHING_TO_MANAGE, waiting.topics(snapshot))
        return
    if _is_draining(snapshot):
        is_pinned = snapshot.settings.link.capacity_bytes_per_second is not None
        hint = "; if it stays, link.capacity pins more than the link carries" if is_pinned else ""
        yield Finding(Condition.QUEUE, f"{_queue(snapshot)}; {_budget(snapshot)} until the queue is short{hint}")
    if not slowed:
        carries = format_rate(snapshot.link.capacity_bytes_per_second)
        now = _unmeasured(snapshot) or _queue_and_loss(snapshot)
        if behind := [row for row in rows if row.is_behind]:
            late = max(behind, key=lambda row: row.most_hz - row.confirmed.published_rate_hz)
            rates = f"{format_number(late.confirmed.published_rate_hz)} of {format_number(late.most_hz)} Hz"
            yield Finding(Condition.BEHIND, f"{late.topic} leaves at {rates}, though {carries} would be enough; {now}")
            return
        why = f"{carries} is more than the robot offers; arpd slows none of {count(planned, 'topic')}"
        yield Finding(Condition.CLEAR, f"{why}; {now}")
        return
    most = slowed[0]
    rates = f"{format_number(most.wanted_hz)} → {format_number(most.allowed_hz)} Hz"
    many = len({row.topic for row in slowed})
    slows = f"arpd slows {many} of {count(planned, 'topic')}, {most.topic} most ({rates})"
    yield Finding(Condition.LIMITED, f"{_budget(snapshot)}, and the robot offers more; {slows}; {_effect(snapshot)}")


def slowed_topics(rows: Iterable[Topic]) -> tuple[Topic, ...]:
    """Return the topics that the link keeps below their sources' rates now, the most slowed first."""
    return tuple(sorted((row for row in rows if row.is_slowed), key=lambda row: (row.kept_ratio, row.topic)))


def _is_draining(snapshot: Snapshot) -> bool:
    """Return whether a queue stands, or arpd leaves the topics little until one has gone."""
    link = snapshot.link
    if link.state in {LinkState.CONGESTED, LinkState.DRAINING}:
        return True
    # The level knows the headroom, and the estimate knows the link of this moment.
    usable = min(snapshot.decision.plan.level_bytes_per_second, link.available_bytes_per_second)
    return snapshot.allocation.budget_bytes_per_second < _DRAINS_BELOW * usable


def _budget(snapshot: Snapshot) -> str:
    budget, capacity = snapshot.allocation.budget_bytes_per_second, snapshot.link.capacity_bytes_per_second
    most = format_rate(budget) if budget >= _LEAST_BUDGET * capacity else "next to nothing"
    cross = snapshot.link.cross_traffic_bytes_per_second
    beside = f" beside {format_rate(cross)} of cross traffic" if cross > _MUCH_CROSS * capacity else ""
    return f"topics may use {most} of {format_rate(capacity)}{beside}"


def who_confirmed(snapshot: Snapshot) -> str:
    """Say how many publishers run the plan in force."""
    return confirmed(confirmed=snapshot.confirmed, publishers=snapshot.managed)


def _effect(snapshot: Snapshot) -> str:
    """Say whether a decision helped: little queues then; a radio may lose packets all the same."""
    link = snapshot.link
    if without := _unmeasured(snapshot):
        return without
    is_short = link.queue_delay_s <= link.queue_allowance_s
    return f"{'' if is_short else 'still '}{_queue_and_loss(snapshot)}"


def _unmeasured(snapshot: Snapshot) -> str:
    """Say that no peer measures the queue, empty where one does."""
    if waiting.is_reported(snapshot):
        return ""
    return "no peer reports, so nobody measures the queue beyond this computer"


def _queue_and_loss(snapshot: Snapshot) -> str:
    loss = snapshot.link.loss_ratio or 0.0
    return f"{_queue(snapshot)} and {format_share(loss)} loss" if loss > _LOSSY else _queue(snapshot)


def _queue(snapshot: Snapshot) -> str:
    delay_s = snapshot.link.queue_delay_s
    if not math.isfinite(delay_s):
        return "a queue of unknown length"
    return f"{format_duration(delay_s)} of queue" if delay_s >= _EMPTY_QUEUE_S else "no queue"


def status_line(snapshot: Snapshot | None) -> str:
    """Return one line for ``systemctl status``; rates are rounded, so that it changes rarely."""
    if snapshot is None:
        return "starting"
    # Judged whole only while nothing is planned: such a judgement reads every topic.
    found = lasting(snapshot) if snapshot.managed else judge(snapshot).findings
    first = (Condition.STANDING_BY, Condition.OUTAGE, Condition.MEASURING, Condition.NOTHING_TO_MANAGE)
    waits = next((finding.phrase for finding in found if finding.condition in first), "")
    faults = [finding.phrase for finding in found if _is_fault(finding)]
    # Without a topic all that is asked for is allowed, also while the link is down.
    fault, figures = _interface_fault(snapshot), _figures(snapshot) if snapshot.managed else ""
    return "; ".join(filter(None, [fault, waits or figures, *faults]))


def _figures(snapshot: Snapshot) -> str:
    link, decision = snapshot.link, snapshot.decision
    return (
        f"{link.capacity_bytes_per_second * 8e-6:.1f} Mbit/s ({link.kind}, {link.state.words}, "
        f"{link.cross_traffic_bytes_per_second * 8e-6:.1f} cross traffic), "
        f"allowed {format_share(round(decision.allowed * _STEPS) / _STEPS)}, "
        f"plan {decision.plan.generation}: {who_confirmed(snapshot)}"
    )
