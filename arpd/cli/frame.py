"""The frame that `arpd status` prints and `arpd top` keeps on the screen, drawn from the daemon's documents."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.styled import Styled
from rich.text import Text

from arpd.cli.output import fitted, wall_clock, wrapped
from arpd.model.quantities import (
    format_duration,
    format_number,
    format_period,
    format_rate,
    format_share,
    format_size,
    printable,
)
from arpd.report.conditions import Condition, Event
from arpd.report.wording import PACED_ONLY, confirmed
from arpd.web.api import Finding, History, Plan, Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rich.segment import Segment
    from rich.table import Table

    from arpd.model.endpoints import PublisherState
    from arpd.model.plan import TopicPlan
    from arpd.model.relay import RelaySummary
    from arpd.report.topic_rows import Topic

    Show = Callable[[float], str]
    Worst = Callable[[Iterable[float]], float]

_LABEL, _FIGURES, _LEGEND = 9, 44, 14
_LEAST_SPARKLINE, _MOST_SPARKLINE = 8, 60
_EVENTS = 5
_DAY_S = 86_400.0
_VERDICTS = {"info": "bold green", "warning": "bold yellow", "error": "bold red"}
_SEVERITIES = {"info": "", "warning": "yellow", "error": "red"}
_BLOCKS = "▁▂▃▄▅▆▇█"
_LEASE = "after {:g} s without this daemon, publishers return to their own QoS"
_NOT_READY = "Not ready: the daemon has just started or is stuck; if this stays, see journalctl -u arpd."


def findings(status: Status | None) -> list[Finding]:
    """Return what the daemon says of its situation: its verdict, then faults, the worst first."""
    if status is None:
        what = Condition.STALE
        return [Finding(condition=what, severity=what.severity, headline="Not ready", text=_NOT_READY, wrong=True)]
    return [status.verdict, *status.faults]


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """A daemon's documents, for rich to print.

    The topics come last, those that give up most first, so that a screen, which does not scroll, cuts off the others.

    Parameters
    ----------
    status : what the daemon says, None before its first tick
    history : its last ten minutes, None where there are none
    url : address of the daemon
    silent_s, why_silent : time since its last answer (s), and why the last try failed; empty while it answers
    """

    status: Status | None
    history: History | None = None
    url: str = ""
    silent_s: float = 0.0
    why_silent: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterable[Segment]:
        """Yield the frame, no line wider than the console."""
        width, status = options.max_width, self.status
        body: list[RenderableType] = []
        if status is not None:
            topics = sorted(status.topics, key=_rank)
            body += [
                "",
                *self._courses(status, width),
                *_facts(status, width),
                "",
                *_log(status.events[-_EVENTS:], status),
            ]
            body += ["", _topic_table(topics, width)] if topics else []
        frame = Group(*self._head(width), Styled(Group(*body), "dim" if self.why_silent else ""))
        yield from console.render(frame, options.update(height=None, no_wrap=True, overflow="ellipsis"))

    def _head(self, width: int) -> Iterator[Text]:
        at, url = "", f", {printable(self.url, longest=80)}" if self.url else ""
        if status := self.status:
            at = wall_clock(status.unix_time_s)
            when = f"{at} ({format_duration(status.age_s)} ago)"
            yield Text(f"arpd {status.version} on {status.interface or 'no link'}, {when}{url}", style="bold")
        else:
            yield Text(f"arpd{url}", style="bold")
        said = [
            (f"wrong: {each.text}", "bold red") if each.wrong else (each.text, _VERDICTS[each.severity])
            for each in findings(self.status)
        ]
        if self.why_silent:
            of = f", this is from {at}" if at else ""
            lost = f"no answer for {self.silent_s:.0f} s{of}: {printable(self.why_silent, longest=200)}"
            said.insert(0, (lost, "bold red"))
        for words, style in said:
            yield from (Text(line, style=style) for line in wrapped(words, width, indent=2, most=4))

    def _courses(self, status: Status, width: int) -> Iterator[Text]:
        """Yield the values that the history has a course of, now and over the last ten minutes."""
        link, past = status.link, self.history.link if self.history else {}
        queue = [format_duration(link.queue_delay_s)]
        queue += [] if link.loss_ratio is None else [f"loss {format_share(link.loss_ratio)}"]
        queue += [] if link.return_delay_s is None else [f"return delay {format_duration(link.return_delay_s)}"]
        capacity = f"{format_rate(link.capacity_bytes_per_second)} ({link.kind}, {link.state.words})"
        allowed = f"{format_share(status.allowed_ratio)} above the minimum rates"
        courses: list[tuple[str, str, str, Worst, Show]] = [
            ("link", capacity, "capacity_bytes_per_second", fmean, format_rate),
            ("queue", ", ".join(queue), "queue_delay_s", max, format_duration),
            ("allowed", allowed, "allowed_ratio", min, format_share),
        ]
        for label, now, name, worst, show in courses:
            line = _labelled(f"{label:{_LABEL}}{now}")
            known = [sample for sample in past.get(name, ()) if sample is not None]
            columns = min(_MOST_SPARKLINE, width - _LABEL - _FIGURES - _LEGEND)
            if known and columns >= _LEAST_SPARKLINE and len(line) < _LABEL + _FIGURES:
                top, extreme = (1.0, f"≥ {show(min(known))}") if worst is min else (max(known), f"≤ {show(max(known))}")
                line.pad_right(_LABEL + _FIGURES - len(line))
                line.append(sparkline(past[name], columns, worst, top)).append(f" {extreme}", style="dim")
            yield line


def _facts(status: Status, width: int) -> list[Text]:
    """Return everything but courses, log and topics, each fact in two lines at most."""
    plan = status.plan
    facts = [
        ("traffic", _traffic(status)),
        ("evidence", status.link.evidence),
        ("plan", _plan(plan)),
        ("", plan.reason),
        ("program", _program(status)),
        ("relay", _relay(status.relay) if status.relay else ""),
        ("lease", _LEASE.format(status.lease_s) if status.lease_s else ""),
        ("rmw", status.rmw_refusal),
    ]
    return [
        _labelled(line)
        for label, fact in facts
        if fact
        for line in wrapped(f"{label:{_LABEL}}{fact}", width, indent=_LABEL)
    ]


def _plan(plan: Plan) -> str:
    confirms = confirmed(confirmed=plan.confirmed, publishers=plan.publishers, paced_only=plan.paced_only)
    return (
        f"{plan.generation} for {format_rate(plan.level_bytes_per_second)}: {confirms}"
        if plan.generation
        else "none yet"
    )


def _traffic(status: Status) -> str:
    link = status.link
    budget = format_rate(status.budget_bytes_per_second)
    said = f"delivering {format_rate(link.delivery_rate_bytes_per_second)}, budget {budget}"
    if not link.cross_traffic_bytes_per_second:
        return said
    left = format_rate(link.available_bytes_per_second)
    return f"{said}, {format_rate(link.cross_traffic_bytes_per_second)} of cross traffic, {left} left"


def _program(status: Status) -> str:
    solved, memory = status.allocation, status.memory
    said = f"{solved.status}, bound by {solved.binding.replace('_', ' ')}"
    left = f"{format_size(memory.available_bytes)} of {format_size(memory.total_bytes)} memory available"
    return f"{said} ({solved.backend}, {format_duration(solved.solve_s)}); {left}"


def _relay(relay: RelaySummary) -> str:
    to_base, to_robot = (f"{way.wanted} of {way.offered}" for way in (relay.to_base, relay.to_robot))
    others = (
        (relay.incomplete, "samples of incomplete groups dropped"),
        (sum(relay.calls_failed.values()), "calls failed"),
        (len(relay.strangers), "nodes in the link domain that are not arpd's"),
    )
    host = f" ({relay.other_host})" if relay.other_host else ""
    now = "cross" if relay.is_reachable else "wait to cross"
    crosses = f"{to_base} topics {now} to the base computer{host}, {to_robot} to the robot"
    return "; ".join([crosses, *(f"{many} {what}" for many, what in others if many)])


def _log(events: Sequence[Event], status: Status) -> Iterator[Text]:
    for event in events:
        at_s = event.unix_time_s
        is_recent = abs(status.unix_time_s - at_s) < _DAY_S
        when = wall_clock(at_s, "%H:%M:%S" if is_recent else "%b %d %H:%M")
        line = Text(f"{when}  {event.text}", style=_SEVERITIES[event.severity])
        line.stylize("dim", 0, len(when))
        yield line


def _topic_table(topics: Sequence[Topic], width: int) -> Table:
    """Return a heading and a line per topic; QoS as ``now→planned`` where the two differ."""
    is_shared = len({topic.topic for topic in topics}) < len(topics)
    columns: list[tuple[str, int, Callable[[Topic], str]]] = [
        ("TOPIC", 0, lambda topic: topic.topic),
        ("NODE", 2, lambda topic: topic.node if is_shared else ""),
        ("ALLOWED", 0, _allowed),
        ("SENT", 0, lambda topic: format_number(topic.confirmed.published_rate_hz)),
        ("SOURCE", 4, lambda topic: format_number(topic.confirmed.source_rate_hz)),
        ("DEPTH", 5, lambda topic: _moving(topic, lambda qos: format_number(qos.depth))),
        ("DEADLINE", 6, lambda topic: _moving(topic, lambda qos: format_period(qos.deadline_ns))),
        ("WITHHELD", 1, _withheld),
        ("LATE", 3, lambda topic: str(topic.confirmed.deadlines_missed or "")),
        ("BOUND BY", 0, _bound_by),
    ]
    filled = [(title, rank, [cell(topic) for topic in topics]) for title, rank, cell in columns]
    titles, ranks, cells = zip(*(column for column in filled if any(column[2])), strict=True)
    rows = [titles, *zip(*cells, strict=True)]
    return fitted(rows, width, ranks=ranks, words={"BOUND BY"}, styles=[_style(topic) for topic in topics])


def _rank(topic: Topic) -> tuple[bool, float, float, str, str]:
    """Order by what an operator looks for: refusals, then topics that give up most, then those that use most."""
    kept = topic.kept_ratio if topic.is_slowed else 1.0
    return not _is_refused(topic), kept, -(topic.allocation.share if topic.allocation else 0.0), topic.topic, topic.node


def _is_refused(topic: Topic) -> bool:
    return bool(topic.confirmed.refusal) and not topic.keeps_qos


def _style(topic: Topic) -> str:
    if _is_refused(topic):
        return "red"
    if topic.is_slowed:
        return "yellow"
    return "" if topic.planned else "dim"


def _allowed(topic: Topic) -> str:
    rate_hz = topic.confirmed.paced_rate_hz
    return format_number(rate_hz) if math.isfinite(rate_hz) else "unpaced"


def _moving(topic: Topic, show: Callable[[PublisherState | TopicPlan], str]) -> str:
    """Show the announced value, and the planned one where the two differ."""
    now, planned = show(topic.confirmed), show(topic.planned or topic.confirmed)
    return now if now == planned else f"{now}→{planned}"


def _withheld(topic: Topic) -> str:
    withheld, offered = topic.confirmed.withheld, topic.confirmed.offered
    return format_share(withheld / offered) if offered else str(withheld)


def _bound_by(topic: Topic) -> str:
    if refusal := topic.confirmed.refusal:
        return f"{PACED_ONLY}: {refusal}" if topic.keeps_qos else refusal
    return topic.allocation.binding.replace("_", " ") if topic.allocation else "-"


def _labelled(line: str) -> Text:
    shown = Text(line)
    shown.stylize("bold", 0, _LABEL)
    return shown


def sparkline(samples: Sequence[float | None], columns: int, worst: Worst, top: float) -> str:
    """Draw the worst of the samples that share a column, from 0 to ``top``; a blank where there is none."""
    columns = min(columns, len(samples))
    drawn = []
    for column in range(columns):
        share = samples[column * len(samples) // columns : (column + 1) * len(samples) // columns]
        there = [sample for sample in share if sample is not None]
        height = int(worst(there) / top * len(_BLOCKS)) if there and top > 0 else 0
        drawn.append(_BLOCKS[max(0, min(len(_BLOCKS) - 1, height))] if there else " ")
    return "".join(drawn)
