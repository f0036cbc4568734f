"""Settings of a publisher that parameters and plans have, and their bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.bounds import (
    MOST_DEPTH,
    checked_deadline_ns,
    checked_depth,
    checked_floor_hz,
    checked_packets,
    checked_rate_hz,
    checked_weight,
    checked_wire_bytes,
)
from arpd.adapters.ros.names import DEADLINE, DEPTH, MIN_RATE, PACKETS, RATE, WEIGHT, WIRE_BYTES, parameter_name
from arpd.adapters.ros.plan_message import Setting
from arpd.model.plan import TopicPlan

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from arpd.model.endpoints import WriterQos

SETTINGS = {  # setting → field of TopicPlan, description of the parameter
    DEPTH: ("depth", "KEEP_LAST depth, 1..5000 samples"),
    DEADLINE: ("deadline_ns", "offered deadline period in ns, 0 = infinite"),
    RATE: ("rate_hz", "ceiling of the publish rate in Hz, .inf = unpaced, 0 = paused"),
    MIN_RATE: ("min_rate_hz", "floor in Hz, which the price keeps while the link carries all floors"),
    WEIGHT: ("weight", "share of link time relative to other topics, 0 = the price does not apply"),
    WIRE_BYTES: ("wire_bytes", "bytes of a sample on the link, over all copies"),
    PACKETS: ("packets", "packets of a sample on the link, over all copies"),
}
_CHECKS: dict[str, Callable[[Any], int | float]] = {
    "rate_hz": checked_rate_hz,
    "min_rate_hz": checked_floor_hz,
    "weight": checked_weight,
    "wire_bytes": checked_wire_bytes,
    "packets": checked_packets,
}


def checked(parameter: Any, field: str, own: WriterQos) -> Any:
    """Return a valid setting of a publisher whose application chose ``own``; its type is already right."""
    if field == "depth":
        return checked_depth(parameter, max(MOST_DEPTH, own.depth))
    if field == "deadline_ns":
        return checked_deadline_ns(parameter, own_ns=own.deadline_ns)
    return _CHECKS[field](parameter)


def checked_row(topic: str, row: Mapping[str, Any], own: WriterQos) -> TopicPlan:
    """Return the row of a plan message; its fields have the bounds of the parameters.

    Raises
    ------
    ValueError
        If one is out of bounds; the message names the parameter.
    """
    named = ((field, Setting(parameter_name(topic, name), row[field])) for name, (field, _) in SETTINGS.items())
    return TopicPlan(**{field: checked(setting, field, own) for field, setting in named})


def parameters_of(topic: str, plan: TopicPlan) -> dict[str, int | float]:
    """Return the values of a publisher's parameters by name."""
    return {parameter_name(topic, name): getattr(plan, field) for name, (field, _) in SETTINGS.items()}
