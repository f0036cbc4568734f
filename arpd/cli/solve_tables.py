"""The tables of `arpd solve --config`: every topic at one capacity, or its rate over several."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.cli.columns import aligned, short_name
from arpd.model.allocation import AllocationStatus, Binding
from arpd.model.quantities import format_number, format_rate, format_share, format_size
from arpd.report.wording import count

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.govern.what_if import OfflinePlan, PlannedTopic
    from arpd.model.allocation import Uniform
    from arpd.model.settings import Settings

_COLUMNS = 8  # capacities side by side in as wide a line
_COLUMN = " " * 7  # as wide as its words
_WORDS = {
    Binding.DESIRED_RATE: "desired",
    Binding.LATENCY_BUDGET: "latency",
    Binding.MAX_DEPTH: "max",
}
_SATISFIED, _AT_FLOOR, _BELOW_FLOOR = "=", "_", "!"
_LEGEND = (
    f"{_SATISFIED} has all it desires    {_AT_FLOOR} at its floor    {_BELOW_FLOOR} below its floor    paused: no rate"
)


def topic_table(plan: OfflinePlan, settings: Settings) -> str:
    """Lay out what each topic asks for and gets at one capacity, and what binds it."""
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
        ("", "", "payload", "Rmax", "floor", "desired", "rate", "rate", "link", "DEADLINE", "DEPTH", "bound by", ""),
        ("topic", "weight", "B", "Hz", "Hz", "Hz", "Hz", "%", "%", "ms", "", "rate", "depth"),
    )
    total = (
        *(f"total of {len(rows)}", "", "", "", ""),
        _four(sum(row.topic.desired_rate_hz for row in rows)),
        _four(sum(row.rate_hz for row in rows)),
        *("", _percent(plan.link_share), ""),
        *(str(sum(row.qos.depth for row in rows)), "", ""),
    )
    return "\n".join([*head, "", *aligned([*titles, *map(_topic_cells, rows), total], words=2)])


def sweep_table(plans: Sequence[OfflinePlan], settings: Settings) -> str:
    """Lay out each topic's rate over the capacity, as many capacities in a line as fit."""
    low, high = (format_rate(plan.capacity_bytes_per_second) for plan in (plans[0], plans[-1]))
    lines = [f"link     {_link(f'{low} to {high}', settings, len(plans[0].topics))}"]
    for start in range(0, len(plans), _COLUMNS):
        lines += ["", *_sweep_block(plans[start : start + _COLUMNS])]
    lines += ["", _LEGEND]
    degraded = [plan for plan in plans if plan.allocation.degradation]
    if degraded:
        lines += ["", "what gave way", *aligned([_degraded_cells(plan) for plan in degraded], words=1)]
    return "\n".join(lines)


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
        short_name(topic.name),
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


def _sweep_block(plans: Sequence[OfflinePlan]) -> list[str]:
    def foot(title: str, cell: Callable[[OfflinePlan], str]) -> tuple[str, ...]:
        return (title, "", "", "", *(cell(plan) for plan in plans))

    rows: list[tuple[str, ...]] = [
        ("", "", "floor", "desired", *(_COLUMN for _ in plans)),
        ("topic", "weight", "Hz", "Hz", *(f"{_short_rate(plan.capacity_bytes_per_second)} " for plan in plans)),
    ]
    for same in zip(*(plan.topics for plan in plans), strict=True):
        topic = same[0].topic
        asked = (format_number(topic.weight), _four(topic.min_rate_hz), _four(topic.desired_rate_hz))
        rows.append((short_name(topic.name), *asked, *map(_sweep_cell, same)))
    rows += [
        foot("link used, %", lambda plan: f"{_percent(plan.link_share)} "),
        foot("bound by", lambda plan: _word(plan.allocation.binding)),
        foot("degraded", lambda plan: "yes " if plan.allocation.status is AllocationStatus.DEGRADED else "- "),
    ]
    title, *lines = aligned(rows, words=0)
    return [f"{title}   rate (Hz) at a capacity (bit/s) of", *lines]


def _sweep_cell(row: PlannedTopic) -> str:
    if not row.rate_hz:
        return "paused"
    if row.has_its_wish:
        mark = _SATISFIED
    elif row.is_below_floor:
        mark = _BELOW_FLOOR
    else:
        mark = _AT_FLOOR if row.is_at_floor else " "
    return f"{format_number(row.rate_hz)}{mark}"


def _degraded_cells(plan: OfflinePlan) -> tuple[str, str]:
    return f"  {_short_rate(plan.capacity_bytes_per_second)}", plan.allocation.degradation


def _word(binding: Binding) -> str:
    return _WORDS.get(binding, str(binding))


def _short_rate(bytes_per_second: float) -> str:
    """Write a capacity for the head of a column: ``500k``, ``1.91M`` bit/s."""
    number, unit = format_rate(bytes_per_second).split()
    return number + unit.removesuffix("bit/s")


def _four(value: float) -> str:
    return format_number(value, digits=4)


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.1f}"  # one decimal for all: the points of a column stand below each other
