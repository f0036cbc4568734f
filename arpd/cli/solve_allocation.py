"""`arpd solve --config`: the daemon's plan for a configuration's topics, offline, to tune weights."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from arpd.cli.status_file import SavedStatus, read_status
from arpd.govern.what_if import OfflinePlanner
from arpd.host.config.load import load_settings
from arpd.host.config.yaml_source import Fault, Place, config_error
from arpd.model.errors import ArpdError, UsageError
from arpd.model.quantities import parse_rate, printable
from arpd.model.settings import Backend
from arpd.solve.topics import assumed_traffic, measured_traffic

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from pathlib import Path

    from arpd.govern.what_if import OfflinePlan, PlannedTopic
    from arpd.model.endpoints import PublisherState
    from arpd.model.settings import Settings
    from arpd.solve.topics import Traffic

_FASTEST = "100gbit"  # as in the configuration
_EXAMPLE = "topics: [{name: /camera, payload: 30kB, source_rate_hz: 30}]"


@dataclass(frozen=True, kw_only=True, slots=True)
class _Offered:
    """The topics to plan for.

    Parameters
    ----------
    traffic : one entry per topic, measured where the status file has it, else from the configuration
    publishers : those of the status file
    crossing : topics that cross the link: pinned counts, else those of the status file
    left_out : topics with a name, but without payload and rate
    """

    traffic: tuple[Traffic, ...]
    publishers: tuple[PublisherState, ...]
    crossing: int
    left_out: tuple[str, ...]


def solve_allocation(options: argparse.Namespace) -> int:
    """Run ``arpd solve --config``."""
    capacities = _capacities(options)
    settings = load_settings(options.config, interfaces=None)  # the file may belong to another computer
    offered = _offered(settings, options)
    backend = Backend(options.backend) if options.backend else settings.program.backend
    planner = OfflinePlanner(
        settings, offered.traffic, publishers=offered.publishers, crossing=offered.crossing, backend=backend
    )
    plans = [planner.plan(capacity) for capacity in capacities]
    if options.json:
        documents = [_document(plan, settings, offered.left_out) for plan in plans]
        print(json.dumps(documents if len(plans) > 1 else documents[0], indent=2))
    else:
        from arpd.cli.solve_tables import show_plan, show_rates

        show_rates(plans, settings) if len(plans) > 1 else show_plan(plans[0], settings)
    if offered.left_out:
        print(_note(offered.left_out, options), file=sys.stderr)
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


def _offered(settings: Settings, options: argparse.Namespace) -> _Offered:
    status = SavedStatus() if options.status is None else read_status(options.status)
    publishers, graph = status.publishers, settings.graph
    # A measurement replaces an assumption; the planner sorts both.
    traffic = {each.topic: each for each in (*assumed_traffic(settings), *measured_traffic(publishers))}
    if not traffic:
        raise _nothing_to_plan(options.config, options.status)
    relayed = (settings.relay.link_prefix + name for name in settings.relay.topic_names)
    named = {
        *(topic.name for topic in settings.topics if "*" not in topic.name),
        *relayed,
        *(publisher.topic for publisher in publishers),
    }
    sensing = status.sensing_topics if graph.sensing_topics is None else graph.sensing_topics
    actuation = status.actuation_topics if graph.actuation_topics is None else graph.actuation_topics
    return _Offered(
        traffic=tuple(traffic.values()),
        publishers=publishers,
        crossing=sensing + actuation,
        left_out=tuple(sorted(named - traffic.keys())),
    )


def _nothing_to_plan(config: Path, status: Path | None) -> ArpdError:
    wrong = "no topic has a payload and a source_rate_hz"
    if status is None:
        right = (
            f"write `{_EXAMPLE}`, or take both from a robot: arpd status --json > robot.json, then --status robot.json"
        )
    else:
        wrong += f", and {printable(str(status), longest=4096)} has none that publishes across the link"
        right = f"write `{_EXAMPLE}`, or save the status while the robot publishes"
    return config_error(config, [Fault(place=Place(), key="topics", text=f"{wrong}; {right}")])


def _note(left_out: Sequence[str], options: argparse.Namespace) -> str:
    names = ", ".join(printable(name, longest=250) for name in left_out)
    wrong = f"{options.config} does not say both their payload and their source_rate_hz"
    if options.status is None:
        return f"arpd: left out: {names}; {wrong} (or measure them: --status)"
    return f"arpd: left out: {names}; {options.status} has no traffic of these topics across the link, and {wrong}"


def _document(plan: OfflinePlan, settings: Settings, left_out: Sequence[str]) -> dict[str, Any]:
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
        "left_out": list(left_out),
    }


def _topic(row: PlannedTopic) -> dict[str, Any]:
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
