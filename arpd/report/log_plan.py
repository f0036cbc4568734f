"""Events of plans: why arpd made a new one, and what it changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.quantities import format_period, format_rate
from arpd.report.conditions import Event, Happening, Severity
from arpd.report.wording import Change, changes, count, joined, listed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from arpd.model.link import LinkEstimate
    from arpd.model.plan import QosPlan, TopicPlan
    from arpd.report.snapshot import Snapshot


class PlanLog:
    """New plans; one that asks for the same as the one before is none, though its level may differ."""

    def __init__(self) -> None:
        self._plan: QosPlan | None = None
        self._link: LinkEstimate | None = None  # when the plan was made

    def follow(self, snapshot: Snapshot) -> Iterator[Event]:
        """Return what happened since the snapshot before."""
        plan, before = snapshot.decision.plan, self._plan
        self._plan = plan
        if plan.generation == 0:
            self._link = None
        elif before is None or (plan.generation, plan.topics) != (before.generation, before.topics):
            yield _new_plan(snapshot, before, self._link)
            self._link = snapshot.link


def _new_plan(snapshot: Snapshot, before: QosPlan | None, link_then: LinkEstimate | None) -> Event:
    plan, cause = snapshot.decision.plan, snapshot.decision.reason
    rows = before.topics if before is not None else {}
    depths, deadlines = _changes(snapshot, rows)
    depth_words, deadline_words = changes(depths, " samples"), changes(deadlines, show=format_period)
    changed = {change.name for change in (*depths, *deadlines)}
    details = {
        "cause": cause,
        "generation": str(plan.generation),
        "capacity_bytes_per_second": f"{snapshot.link.capacity_bytes_per_second:.6g}",
        "level_bytes_per_second": f"{plan.level_bytes_per_second:.6g}",
        "topics": str(len(plan.topics)),
        "topics_changed": str(len(changed)),
    }
    what = [f"depth {depth_words}"] if depth_words else []
    what += [f"deadline {deadline_words}"] if deadline_words else []
    if what and (unchanged := len(plan.topics.keys() - changed)):
        what.append(f"{count(unchanged, 'topic')} unchanged")
    less = sum(change.after - change.before for change in depths) < 0
    return Event(
        Happening.PLAN,
        Severity.WARNING if cause == "down" or (cause == "memory" and less) else Severity.INFO,
        f"{_why(snapshot, before, link_then)}: {'; '.join(what) or 'no depth or deadline changes'}",
        details=details,
    )


_OTHER_CAUSES = {
    "budget": "swaps are allowed again",
    "memory": "the memory for message histories has changed",
    "demand": "what the sources publish has changed",
    "reload": "new configuration",
    "readers": "a reader asks for a shorter deadline",
    "takeover": "another daemon's plan was found, this one replaces it",
}


def _why(snapshot: Snapshot, before: QosPlan | None, then: LinkEstimate | None) -> str:
    plan, cause = snapshot.decision.plan, snapshot.decision.reason
    if cause == "start":
        carries = format_rate(snapshot.link.capacity_bytes_per_second)
        return f"first plan for {count(len(plan.topics), 'topic')} on a link of {carries}"
    if cause == "topics":
        return _topics_that_came(plan, before)
    if cause in {"down", "up"}:
        return _what_the_link_did(snapshot.link, then, plan, fell=cause == "down")
    return _OTHER_CAUSES.get(cause, f"plan {plan.generation}")


def _topics_that_came(plan: QosPlan, before: QosPlan | None) -> str:
    old, now = (
        {name for name, row in each.topics.items() if row.depth} if each is not None else set()
        for each in (before, plan)
    )
    back = plan.topics.keys() - now - (before.topics.keys() - old if before is not None else set())
    moved = ((sorted(now - old), "joined"), (sorted(old - now - back), "left"), (sorted(back), "given back"))
    words = [f"{listed(names)} {how}" for names, how in moved if names]
    return f"{joined(words) if words else 'topics came and went'}, {len(now)} planned"


def _what_the_link_did(link: LinkEstimate, then: LinkEstimate | None, plan: QosPlan, *, fell: bool) -> str:
    """Say what made the lasting budget fall or rise: cross traffic, the link, or a link that swings."""
    carries = format_rate(link.capacity_bytes_per_second)
    left = 0.0 if then is None else link.available_bytes_per_second - then.available_bytes_per_second
    if then is not None and (left < 0.0) != fell:
        # A link that swings is high at one moment and low at the next; the plan follows what lasts.
        lasts = f"{'only ' if fell else ''}{format_rate(plan.level_bytes_per_second)}"
        return f"topics can count on {lasts}, though the link carries {carries} now"
    if then is not None and _is_cross_traffic(link, then):
        takes = f"{'takes' if fell else 'takes only'} {format_rate(link.cross_traffic_bytes_per_second)}"
        return f"cross traffic {takes}, leaving {format_rate(link.available_bytes_per_second)} of {carries}"
    return f"link {'fell' if fell else 'rose'} to {carries}"


def _is_cross_traffic(link: LinkEstimate, then: LinkEstimate) -> bool:
    """Return whether cross traffic moved what is left for arpd by more than the link itself did."""
    capacity = link.capacity_bytes_per_second - then.capacity_bytes_per_second
    left = link.available_bytes_per_second - then.available_bytes_per_second
    return left * (left - 2 * capacity) > 0


def _changes(snapshot: Snapshot, before: Mapping[str, TopicPlan]) -> tuple[list[Change], list[Change]]:
    depths: dict[str, Change] = {}
    deadlines: dict[str, Change] = {}
    for publisher in snapshot.observation.publishers:
        name, size = publisher.topic, publisher.payload_bytes
        if (row := snapshot.decision.plan.topics.get(name)) is None:
            continue
        was_row, (depth, deadline_ns) = before.get(name), publisher.qos_by(row)
        was_depth, was_ns = publisher.qos_by(was_row) if was_row else (publisher.depth, publisher.deadline_ns)
        if was_depth != depth and not publisher.keeps_all:
            depths[name] = Change(name, was_depth, depth, abs(depth - was_depth) * size)
        if was_ns != deadline_ns:
            deadlines[name] = Change(name, was_ns, deadline_ns, size * publisher.copies)
    return list(depths.values()), list(deadlines.values())
