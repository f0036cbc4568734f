"""The daemon's reader of snapshots (`arpd.ros.node_snapshot`): every value is checked."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError

from arpd.model.endpoints import (
    Direction,
    NodeSnapshot,
    RefusalReason,
    SwapPhase,
    SwapRecord,
    SwapResult,
    WithheldCause,
)
from arpd.model.plan import MOST_GENERATION, PlanAnswer
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.ros.bounds import MOST_LEASE_S
from arpd.ros.documents import MOST_INTEGER, expand
from arpd.ros.names import is_full_name
from arpd.ros.node_snapshot import LIKELY, MOST, MOST_BYTES, MOST_NAMED, MOST_OF_NODE, MOST_SECONDS, shown_words

if TYPE_CHECKING:
    from enum import StrEnum


def _checked_name(name: str) -> str:
    if not is_full_name(name):
        raise ValueError("no fully qualified ROS name")
    return name


def _unpaced_as_infinite(rates: list[float | None]) -> list[float]:
    return [math.inf if rate is None else rate for rate in rates]


def _keyed_by(names: type[StrEnum]) -> tuple[Any, ...]:
    """Return what lets known names pass alone: each becomes a label of a metric."""
    known = {name.value for name in names}

    def check(found: dict[str, Any]) -> dict[str, Any]:
        if found.keys() - known:
            raise ValueError(f"none but {', '.join(sorted(known))} are known")
        return found

    return Field(max_length=len(known)), AfterValidator(check)


def _most(name: str, *, least: int = 0) -> Any:
    return Field(ge=least, le=MOST[name])


Name = Annotated[str, AfterValidator(_checked_name)]
Text = Annotated[str, AfterValidator(shown_words)]
Count = Annotated[int, Field(ge=0, le=MOST_INTEGER)]
Generation = Annotated[int, Field(ge=0, le=MOST_GENERATION)]
Seconds = Annotated[float, Field(ge=0.0, le=MOST_SECONDS)]
T = TypeVar("T")
# A short message may unfold to 400,000 faults, which took 2 s to write down; the first one is enough.
Column = Annotated[list[T], Field(max_length=MOST_OF_NODE), FailFast()]
Rates = Annotated[Column[Seconds | None], AfterValidator(_unpaced_as_infinite)]
Words = Annotated[dict[Text, Text], Field(max_length=MOST_NAMED)]
Phases = Annotated[dict[str, Seconds], *_keyed_by(SwapPhase)]
Results = Annotated[dict[str, Count], *_keyed_by(SwapResult)]
Causes = Annotated[dict[str, Count], *_keyed_by(WithheldCause)]


class _Told(BaseModel):
    # Unknown names are ignored: each would be an error to write down, and a message may have 70,000.
    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)


class _Swap(_Told):
    number: Count
    result: SwapResult
    depth: Count
    deadline_ns: Count
    seconds_by_phase: Phases


class _Publishers(_Told):
    """A list for each field; an empty one where all have the usual value."""

    topic: Column[Name] = []
    type_name: Column[Text] = []
    payload_bytes: Column[Annotated[float, _most("payload_bytes")]] = []
    source_rate_hz: Column[Annotated[float, _most("source_rate_hz")]] = []
    published_rate_hz: Column[Annotated[float, _most("published_rate_hz")]] = []
    offered: Column[Count] = []
    published: Column[Count] = []
    queued: Column[Count] = []
    blocked_s: Column[Seconds] = []
    rate_hz: Rates = []
    paced_rate_hz: Rates = []
    depth: Column[Annotated[int, _most("depth", least=1)]] = []
    deadline_ns: Column[Count] = []
    baseline_depth: Column[Annotated[int, _most("baseline_depth", least=1)]] = []
    baseline_deadline_ns: Column[Count] = []
    swaps_by_result: Column[Results] = []
    withheld_by_cause: Column[Causes] = []
    deadlines_missed: Column[Count] = []
    swaps_begun: Column[Count] = []
    swap_seconds_by_phase: Column[Phases] = []
    last_swap: Column[_Swap | None] = []
    refusal: Column[Text] = []
    refusal_reason: Column[RefusalReason] = []
    keeps_all: Column[bool] = []

    def rows(self) -> list[dict[str, Any]]:
        """Return the fields of each publisher.

        Raises
        ------
        ValueError
            If the lists are not of one length, or some publisher lacks a field that has no usual value.
        """
        columns = {name: values for name, values in vars(self).items() if values}
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        for row in rows:
            row["withheld"] = min(MOST_INTEGER, sum(row.get("withheld_by_cause", {}).values()))
            if swap := row.get("last_swap"):
                row["last_swap"] = SwapRecord(**vars(swap))
        if rows and not columns.keys() >= _NEEDED:
            raise ValueError(f"publishers lack {', '.join(sorted(_NEEDED - columns.keys()))}")
        return rows


_NEEDED = {"topic", "type_name", "payload_bytes", "source_rate_hz", "depth", "baseline_depth"}


class _Answer(_Told):
    generation: Generation = 0
    lease_s: Annotated[float, Field(ge=0.0, le=MOST_LEASE_S)] = 0.0
    refused: Generation = 0
    refusal: Text = ""


class _Topics(_Told):
    offered: Count = 0
    wanted: Count = 0
    refused: Words = Field(default_factory=dict)


class _Relay(_Told):
    other_host: Text = ""
    is_reachable: bool = False
    fault: Text = ""
    to_base: _Topics = _Topics()
    to_robot: _Topics = _Topics()
    received: Count = 0
    doubled: Count = 0
    unknown: Count = 0
    outdated: Count = 0
    link_bytes: Count = 0
    incomplete: Count = 0
    calls_failed: Annotated[dict[Text, Count], Field(max_length=MOST_NAMED)] = Field(default_factory=dict)
    strangers: Annotated[tuple[Text, ...], Field(max_length=MOST_NAMED), FailFast()] = ()
    types_differ: Words = Field(default_factory=dict)

    def summary(self) -> RelaySummary:
        topics = {name: RelayTopics(**vars(getattr(self, name))) for name in ("to_base", "to_robot")}
        return RelaySummary(**{**vars(self), **topics})


class _Snapshot(_Told):
    node: Name
    publishers: _Publishers = _Publishers()
    answer: _Answer = _Answer()
    lacks_profile: bool = False
    relay: _Relay | None = None


def decode_snapshot(data: bytes) -> NodeSnapshot:
    """Return what a node tells.

    Raises
    ------
    ValueError
        If a value is missing, malformed or out of range; the message names it.
    """
    text = expand(data, most_bytes=MOST_BYTES, likely=LIKELY)
    try:
        told = _Snapshot.model_validate_json(text)
    except ValidationError as faults:
        fault = faults.errors(include_url=False)[0]
        place = ".".join(map(str, fault["loc"]))
        raise ValueError(f"snapshot of a node: {place} = {str(fault['input'])[:40]!r}: {fault['msg']}") from faults
    answer = PlanAnswer(**vars(told.answer))
    common = {
        "node": told.node,
        "direction": Direction.LOCAL,  # until the graph shows more
        "generation": answer.generation,
        "lease_s": answer.lease_s,
        "lacks_profile": told.lacks_profile,
    }
    return NodeSnapshot(
        node=told.node,
        answer=answer,
        publishers=[{**common, **row} for row in told.publishers.rows()],
        relay=None if told.relay is None else told.relay.summary(),
    )
