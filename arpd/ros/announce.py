"""Announcements of live publishers on /arpd/publishers, to and from diagnostic_msgs."""

from __future__ import annotations

import math
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from arpd.model import Direction, PublisherState

_SWAP_PREFIX = "swaps_"
_FLOATS = ("payload_bytes", "source_rate_hz", "blocked_s", "rate_hz", "lease_s")
_INTEGERS = (
    "offered",
    "published",
    "withheld",
    "queued",
    "depth",
    "deadline_ns",
    "baseline_depth",
    "baseline_deadline_ns",
    "generation",
)
_MAX_INTEGER = 2**63 - 1
_MAX_NAME = 256
_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def to_status(state: PublisherState) -> Any:
    """Encode one publisher as a DiagnosticStatus; a refusal shows as WARN in any diagnostics viewer."""
    values = [("node", state.node), ("topic", state.topic), ("type", state.type_name), ("refusal", state.refusal)]
    values += [(key, f"{getattr(state, key):.6g}") for key in _FLOATS]
    values += [(key, str(getattr(state, key))) for key in _INTEGERS]
    values += [(_SWAP_PREFIX + result, str(count)) for result, count in sorted(state.swaps_by_result.items())]
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if state.refusal else DiagnosticStatus.OK,
        name=f"{state.node}: {state.topic}",
        message=state.refusal or f"{state.rate_hz:.3g} Hz, depth {state.depth}",
        hardware_id="",
        values=[KeyValue(key=key, value=value) for key, value in values],
    )


def from_status(status: Any) -> PublisherState:
    """Decode one announcement; what came over the network is checked before anything believes it.

    Raises
    ------
    ValueError
        If a field is missing, malformed or out of range; the message names it.
    """
    values = {pair.key: pair.value for pair in status.values}
    try:
        node, topic, type_name = values["node"], values["topic"], values["type"]
        floats = {key: _finite_or_inf(key, values[key]) for key in _FLOATS}
        integers = {key: _bounded(key, values[key]) for key in _INTEGERS}
        swaps = {
            key.removeprefix(_SWAP_PREFIX): _bounded(key, value)
            for key, value in values.items()
            if key.startswith(_SWAP_PREFIX)
        }
    except KeyError as missing:
        raise ValueError(f"announcement without {missing}") from missing
    for name in (node, topic):
        if len(name) > _MAX_NAME or not _NAME.fullmatch(name):
            raise ValueError(f"announcement with the name {name[:80]!r}; a fully qualified ROS name is needed")
    if not 1 <= integers["depth"] <= 100_000 or not 1 <= integers["baseline_depth"] <= 100_000:
        raise ValueError(f"announcement of {topic} with a depth outside 1..100000")
    return PublisherState(
        node=node,
        topic=topic,
        type_name=type_name[:_MAX_NAME],
        direction=Direction.LOCAL,
        swaps_by_result=swaps,
        refusal=values.get("refusal", "")[:_MAX_NAME],
        **floats,  # type: ignore[arg-type]
        **integers,
    )


def _finite_or_inf(key: str, text: str) -> float:
    value = float(text)
    if math.isnan(value) or value < 0 or (math.isinf(value) and key != "rate_hz"):
        raise ValueError(f"announcement with {key} = {text[:40]!r}; a number ≥ 0 is needed")
    return value


def _bounded(key: str, text: str) -> int:
    value = int(text)
    if not 0 <= value <= _MAX_INTEGER:
        raise ValueError(f"announcement with {key} = {text[:40]!r}; an integer from 0 to 2^63-1 is needed")
    return value
