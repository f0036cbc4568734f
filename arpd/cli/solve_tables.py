"""The tables of `arpd solve --config`: every topic at one capacity, or its rate over several."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from arpd.cli.output import FittedTable, show
from arpd.model.allocation import Binding
from arpd.model.quantities import format_number, format_rate, format_share, format_size
from arpd.report.wording import count

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.govern.what_if import OfflinePlan, PlannedTopic
    from arpd.model.allocation import Uniform
    from arpd.model.settings import Settings

_WORDS = {
    Binding.DESIRED_RATE: "desired",
    Binding.LATENCY_BUDGET: "latency",
    Binding.MAX_DEPTH: "max",
    Binding.MINIMUM: "minimum",
}
_SATISFIED, _AT_FLOOR, _BELOW_FLOOR = "=", "_", "!"
_LEGEND = (
    f"{_SATISFIED} has all it desires    {_AT_FLOOR} at its minimum rate    {_BELOW_FLOOR} below it    paused: no rate"
)


def show_plan(plan: OfflinePlan, settings: Settings) -> None:
    """Print what each topic asks for and gets at one capacity, and what binds it."""
    allocation, rows = plan.allocation, plan.topics
    used, budget = format_size(plan.memory_bytes), format_size(settings.program.memory_budget_bytes)
    head = [
        f"link     {_link(format_rate(plan.capacity_bytes_per_second), settings, len(rows))}",
        f"program  {allocation.status}, bound by {_word(allocation.binding)}, solved by {allocation.backend}",
        *([f"         gave way: {allocation.degradation}"] if allocation.degradation else []),
        *([f"uniform  {_uniform(allocation.uniform)}"] if allocation.uniform else []),
        f"memory   {used} of {budget} when every history is full",
    ]
    titles = (
        *("TOPIC", "WEIGHT", "PAYLOAD\nB", "RMAX\nHZ", "MINIMUM\nHZ", "DESIRED\nHZ", "RATE\nHZ", "RATE\n%", "LINK\n%"),
        *("DEADLINE\nMS", "DEPTH", "RATE\nBOUND BY", "DEPTH\nBOUND BY"),
    )
    total = (
        *(f"total of {len(rows)}", "", "", "", ""),
        _four(sum(row.topic.desired_rate_hz for row in rows)),
        _four(sum(row.rate_hz for row in rows)),
        *("", _percent(plan.link_share), ""),
        *(str(sum(row.qos.depth for row in rows)), "", ""),
    )
    words = frozenset(titles[-2:])
    show(*map(Text, head), "", FittedTable(rows=[titles, *map(_topic_cells, rows), total], words=words))


def show_rates(plans: Sequence[OfflinePlan], settings: Settings) -> None:
    """Print each topic's rate on links of several capacities."""

    def foot(title: str, cell: Callable[[OfflinePlan], str]) -> tuple[str, ...]:
        return (title, "", "", "", *(f"{cell(plan)} " for plan in plans))

    links = [format_rate(plan.capacity_bytes_per_second) for plan in plans]
    titles = (f"{link.replace(' ', chr(10), 1)} " for link in links)
    rows: list[tuple[str, ...]] = [("TOPIC, HZ", "WEIGHT", "MINIMUM\nHZ", "DESIRED\nHZ", *titles)]
    for same in zip(*(plan.topics for plan in plans), strict=True):
        topic = same[0].topic
        asked = (format_number(topic.weight), _four(topic.min_rate_hz), _four(topic.desired_rate_hz))
        rows.append((topic.name, *asked, *map(_rate_cell, same)))
    rows += [
        foot("link used, %", lambda plan: _percent(plan.link_share)),
        foot("bound by", lambda plan: _word(plan.allocation.binding)),
    ]
    about = _link(f"{links[0]} to {links[-1]}", settings, len(plans[0].topics))
    show(Text(f"link     {about}"), "", FittedTable(rows=rows), "", Text(_LEGEND))
    for link, plan in zip(links, plans, strict=True):
        if plan.allocation.degradation:
            show(Text(f"{link}: {plan.allocation.degradation}"))


def _link(capacity: str, settings: Settings, topics: int) -> str:
    planned = format_share(settings.link.headroom)
    return f"{capacity}, of which {planned} may be planned for {count(topics, 'topic')}"


def _uniform(uniform: Uniform) -> str:
    """Say what Eq. (4) gives each topic."""
    share = f"{count(uniform.topics, 'topic')} on the link, Rmax {_four(uniform.max_rate_hz)} Hz"
    return f"{share}: R {_four(uniform.rate_hz)} Hz and D {uniform.depth} for each"


def _topic_cells(row: PlannedTopic) -> tuple[str, ...]:
    topic, allocation = row.topic, row.allocation
    return (
        topic.name,
        format_number(topic.weight),
        _four(row.traffic.payload_bytes),
        _four(allocation.max_rate_hz),
        _four(topic.min_rate_hz),
        _four(topic.desired_rate_hz),
        _four(row.rate_hz) if row.rate_hz else "paused",
        _percent(row.rate_hz / topic.desired_rate_hz) if topic.desired_rate_hz else "-",
        _percent(allocation.share),
        _four(row.qos.deadline_ns * 1e-6) if row.qos.deadline_ns else "none",
        str(row.qos.depth),
        _word(allocation.binding),
        _word(allocation.depth_binding),
    )


def _rate_cell(row: PlannedTopic) -> str:
    if not row.rate_hz:
        return "paused"
    if row.has_its_wish:
        mark = _SATISFIED
    elif row.is_below_floor:
        mark = _BELOW_FLOOR
    else:
        mark = _AT_FLOOR if row.is_at_floor else " "
    return f"{format_number(row.rate_hz)}{mark}"


def _word(binding: Binding) -> str:
    return _WORDS.get(binding, str(binding))


def _four(value: float) -> str:
    return format_number(value, digits=4)


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.1f}"  # one decimal for all: the points of a column stand below each other
