"""`arpd solve --config`: the daemon's plan for a configuration's topics, offline, to tune weights."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from rich.text import Text

from arpd.cli.output import FittedTable, show
from arpd.cli.saved_status import SavedStatus, read_status
from arpd.govern.what_if import OfflinePlanner
from arpd.host.config.load import load_settings
from arpd.host.config.yaml_source import Fault, Place, config_error
from arpd.model.allocation import Binding
from arpd.model.errors import UsageError
from arpd.model.quantities import format_number, format_rate, format_share, format_size, parse_rate, printable
from arpd.model.settings import Backend
from arpd.report.wording import count
from arpd.solve.topics import assumed_traffic, measured_traffic

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    from arpd.govern.what_if import OfflinePlan, PlannedTopic
    from arpd.model.settings import Settings

    Document = Mapping[str, Any]

_FASTEST = "100gbit"  # as in the configuration
_EXAMPLE = "topics: [{name: /camera, payload: 30kB, source_rate_hz: 30}]"
_WORDS: dict[str, str] = {
    Binding.DESIRED_RATE: "desired",
    Binding.LATENCY_BUDGET: "latency",
    Binding.MAX_DEPTH: "max",
    Binding.MINIMUM: "minimum",
}
_ROUNDING = 1e-6  # a rate this close to its minimum is at it
_LEGEND = "= has all it desires    _ at its minimum rate    ! below it    paused: no rate"


def solve_topics(options: argparse.Namespace) -> int:
    """Run ``arpd solve --config``."""
    capacities = _capacities(options)
    settings = load_settings(options.config, interfaces=None)  # the file may belong to another computer
    if options.backend:
        settings = replace(settings, program=replace(settings.program, backend=Backend(options.backend)))
    status = SavedStatus() if options.status is None else read_status(options.status)
    publishers, graph = status.publishers, settings.graph
    # A measurement replaces an assumption; the planner sorts both.
    traffic = {each.topic: each for each in (*assumed_traffic(settings), *measured_traffic(publishers))}
    if not traffic:
        raise config_error(options.config, [Fault(Place(), "topics", _nothing_to_plan(options))])
    sensing = status.sensing_topics if graph.sensing_topics is None else graph.sensing_topics
    actuation = status.actuation_topics if graph.actuation_topics is None else graph.actuation_topics
    planner = OfflinePlanner(settings, traffic.values(), publishers=publishers, crossing=sensing + actuation)
    relayed = {settings.relay.link_prefix + name for name in settings.relay.topic_names}
    named = relayed | {topic.name for topic in settings.topics if not topic.is_pattern}
    left_out = sorted((named | {publisher.topic for publisher in publishers}) - traffic.keys())
    plans = [_document(planner.plan(capacity), settings, left_out) for capacity in capacities]
    if options.json:
        print(json.dumps(plans if len(plans) > 1 else plans[0], indent=2))
    else:
        _show_rates(plans) if len(plans) > 1 else _show_plan(plans[0])
    if left_out:
        print(_note(left_out, options), file=sys.stderr)
    return 0


def _capacities(options: argparse.Namespace) -> list[float]:
    """Return the capacities of the options (bytes/s)."""
    if options.capacity is None:
        raise UsageError("--config needs --capacity RATE (5mbit), or several (1mbit,5mbit,20mbit)")
    try:
        capacities = [parse_rate(rate) for rate in options.capacity.split(",")]
    except ValueError as error:
        raise UsageError(f"--capacity: {error}") from None
    if max(capacities) > parse_rate(_FASTEST):
        raise UsageError(f"--capacity: '{printable(options.capacity)}' is out of range; write at most {_FASTEST}")
    return capacities


def _nothing_to_plan(options: argparse.Namespace) -> str:
    wrong, write = "no topic has a payload and a source_rate_hz", f"write `{_EXAMPLE}`"
    if options.status is None:
        return f"{wrong}; {write}, or take both from a robot: arpd status --json > robot.json, then --status robot.json"
    wrong += f", and {printable(str(options.status), longest=4096)} has none that publishes across the link"
    return f"{wrong}; {write}, or save the status while the robot publishes"


def _note(left_out: Sequence[str], options: argparse.Namespace) -> str:
    names = ", ".join(printable(name, longest=250) for name in left_out)
    wrong = f"{options.config} does not say both their payload and their source_rate_hz"
    if options.status is None:
        return f"arpd: left out: {names}; {wrong} (or measure them: --status)"
    return f"arpd: left out: {names}; {options.status} has no traffic of these topics across the link, and {wrong}"


def _document(plan: OfflinePlan, settings: Settings, left_out: Sequence[str]) -> Document:
    """Return the plan for one capacity as JSON; ``null`` is a DEADLINE that is infinite."""
    allocation = plan.allocation
    return {
        "capacity_bytes_per_second": plan.capacity_bytes_per_second,
        "headroom": settings.link.headroom,
        "level_bytes_per_second": allocation.capacity_bytes_per_second,
        "status": str(allocation.status),
        "binding": str(allocation.binding),
        "degradation": allocation.degradation,
        "backend": str(allocation.backend),
        "policy": str(settings.program.policy),
        "uniform": allocation.uniform and asdict(allocation.uniform),
        "share": plan.link_share,
        "memory_bytes": plan.memory_bytes,
        "memory_budget_bytes": settings.program.memory_budget_bytes,
        "topics": [_topic(row) for row in plan.topics],
        "left_out": left_out,
    }


def _topic(row: PlannedTopic) -> Document:
    traffic, topic, allocation = row.traffic, row.topic, row.allocation
    return {
        "topic": topic.name,
        "weight": topic.weight,
        "payload_bytes": traffic.payload_bytes,
        "source_rate_hz": traffic.source_rate_hz,
        "copies": traffic.copies,
        "wire_bytes": topic.wire_bytes,
        "max_rate_hz": allocation.max_rate_hz,
        "min_rate_hz": topic.min_rate_hz,
        "desired_rate_hz": topic.desired_rate_hz,
        "rate_hz": row.rate_hz,
        "optimal_rate_hz": allocation.rate_hz,
        "share": allocation.share,
        "deadline_ns": row.qos.deadline_ns or None,
        "depth": row.qos.depth,
        "optimal_depth": allocation.depth,
        "rate_binding": str(allocation.binding),
        "depth_binding": str(allocation.depth_binding),
    }


def _show_plan(plan: Document) -> None:
    """Print what each topic asks for and gets at one capacity, and what binds it."""
    rows, uniform = plan["topics"], plan["uniform"]
    used, budget = format_size(plan["memory_bytes"]), format_size(plan["memory_budget_bytes"])
    head = [
        _head([plan]),
        f"program  {plan['status']}, bound by {_word(plan['binding'])}, solved by {plan['backend']}",
        *([f"         gave way: {plan['degradation']}"] if plan["degradation"] else []),
        *([f"uniform  {_uniform(uniform)}"] if uniform else []),
        f"memory   {used} of {budget} when every history is full",
    ]
    titles = (
        *("TOPIC", "WEIGHT", "PAYLOAD\nB", "RMAX\nHZ", "MINIMUM\nHZ", "DESIRED\nHZ", "RATE\nHZ", "RATE\n%", "LINK\n%"),
        *("DEADLINE\nMS", "DEPTH", "RATE\nBOUND BY", "DEPTH\nBOUND BY"),
    )
    desired, rate, depth = (sum(row[key] for row in rows) for key in ("desired_rate_hz", "rate_hz", "depth"))
    total = (f"total of {len(rows)}", "", "", "", "", _four(desired), _four(rate), "", _percent(plan["share"]), "")
    table = [titles, *map(_cells, rows), (*total, str(depth), "", "")]
    show(*map(Text, head), "", FittedTable(rows=table, words=frozenset(titles[-2:])))


def _cells(row: Document) -> tuple[str, ...]:
    return (
        row["topic"],
        format_number(row["weight"]),
        *(_four(row[key]) for key in ("payload_bytes", "max_rate_hz", "min_rate_hz", "desired_rate_hz")),
        _four(row["rate_hz"]) if row["rate_hz"] else "paused",
        _percent(row["rate_hz"] / row["desired_rate_hz"]) if row["desired_rate_hz"] else "-",
        _percent(row["share"]),
        _four(row["deadline_ns"] * 1e-6) if row["deadline_ns"] else "none",
        str(row["depth"]),
        _word(row["rate_binding"]),
        _word(row["depth_binding"]),
    )


def _show_rates(plans: Sequence[Document]) -> None:
    """Print each topic's rate on links of several capacities."""

    def foot(title: str, cell: Callable[[Document], str]) -> tuple[str, ...]:
        return (title, "", "", "", *(f"{cell(plan)} " for plan in plans))

    links = [format_rate(plan["capacity_bytes_per_second"]) for plan in plans]
    titles = (f"{link.replace(' ', chr(10), 1)} " for link in links)
    rows: list[tuple[str, ...]] = [("TOPIC, HZ", "WEIGHT", "MINIMUM\nHZ", "DESIRED\nHZ", *titles)]
    for same in zip(*(plan["topics"] for plan in plans), strict=True):
        asked = (_four(same[0][key]) for key in ("min_rate_hz", "desired_rate_hz"))
        rows.append((same[0]["topic"], format_number(same[0]["weight"]), *asked, *map(_rate_cell, same)))
    rows += [
        foot("link used, %", lambda plan: _percent(plan["share"])),
        foot("bound by", lambda plan: _word(plan["binding"])),
    ]
    gave_way = [
        f"{link}: {plan['degradation']}" for link, plan in zip(links, plans, strict=True) if plan["degradation"]
    ]
    show(Text(_head(plans)), "", FittedTable(rows=rows), "", Text(_LEGEND), *map(Text, gave_way))


def _rate_cell(row: Document) -> str:
    rate_hz, least_hz = row["optimal_rate_hz"], row["min_rate_hz"]
    if not row["rate_hz"]:
        return "paused"
    if row["rate_binding"] == Binding.DESIRED_RATE:
        mark = "="
    elif rate_hz < least_hz * (1 - _ROUNDING):
        mark = "!"
    else:
        mark = "_" if math.isclose(rate_hz, least_hz, rel_tol=_ROUNDING) else " "
    return f"{format_number(row['rate_hz'])}{mark}"


def _head(plans: Sequence[Document]) -> str:
    ends = dict.fromkeys(format_rate(plan["capacity_bytes_per_second"]) for plan in (plans[0], plans[-1]))
    share, topics = format_share(plans[0]["headroom"]), count(len(plans[0]["topics"]), "topic")
    return f"link     {' to '.join(ends)}, of which {share} may be planned for {topics}"


def _uniform(uniform: Document) -> str:
    """Say what Eq. (4) gives each topic."""
    share = f"{count(uniform['topics'], 'topic')} on the link, Rmax {_four(uniform['max_rate_hz'])} Hz"
    return f"{share}: R {_four(uniform['rate_hz'])} Hz and D {uniform['depth']} for each"


def _word(binding: str) -> str:
    return _WORDS.get(binding, binding)


def _four(value: float) -> str:
    return format_number(value, digits=4)


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.1f}"  # one decimal for all: the points of a column stand below each other
