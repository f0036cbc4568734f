"""The daemon's reader of snapshots (`arpd.ros.node_snapshot`): every value is checked."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError, create_model

from arpd.model.endpoints import (
    MOST_PUBLISHERS,
    Direction,
    NodeSnapshot,
    PublisherState,
    RefusalReason,
    SwapRecord,
    SwapResult,
    SwapState,
    WithheldCause,
)
from arpd.model.plan import MOST_GENERATION, NO_PLAN, PlanAnswer
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.ros.documents import MOST_INTEGER, expand
from arpd.ros.names import MOST_LEASE_S, checked_full_name
from arpd.ros.node_snapshot import (
    LIKELY,
    MOST,
    MOST_BYTES,
    MOST_NAMED,
    MOST_SECONDS,
    TOLD,
    shown_words,
)

if TYPE_CHECKING:
    from enum import StrEnum


def _keyed_by(names: type[StrEnum]) -> tuple[Any, ...]:
    """Return what lets known names pass alone: each becomes a label of a metric."""
    known = {name.value for name in names}

    def check(found: dict[str, Any]) -> dict[str, Any]:
        if found.keys() - known:
            raise ValueError(f"none but {', '.join(sorted(known))} are known")
        return found

    return Field(max_length=len(known)), AfterValidator(check)


Name = Annotated[str, AfterValidator(checked_full_name)]
Text = Annotated[str, AfterValidator(shown_words)]
Count = Annotated[int, Field(ge=0, le=MOST_INTEGER)]
Seconds = Annotated[float, Field(ge=0.0, le=MOST_SECONDS)]
T = TypeVar("T")
# A short message may unfold to 400,000 faults, which took 2 s to write down; the first one is enough.
Column = Annotated[list[T], Field(max_length=MOST_PUBLISHERS), FailFast()]
_UNPACED_AS_INFINITE = AfterValidator(lambda rates: [math.inf if rate is None else rate for rate in rates])
Rates = Annotated[Column[Seconds | None], _UNPACED_AS_INFINITE]
#: Of the fields of all records by the words that declare them, and of some by their names.
KINDS: dict[str, Any] = {
    "str": Text,
    "int": Count,
    "float": Seconds,
    "bool": bool,
    "Mapping[str, str]": Annotated[dict[Text, Text], Field(max_length=MOST_NAMED)],
    "Mapping[str, int]": Annotated[dict[Text, Count], Field(max_length=MOST_NAMED)],
    "tuple[str, ...]": Annotated[tuple[Text, ...], Field(max_length=MOST_NAMED), FailFast()],
    "topic": Name,
    "result": SwapResult,
    "generation": Annotated[int, Field(ge=0, le=MOST_GENERATION)],
    "lease_s": Annotated[float, Field(ge=0.0, le=MOST_LEASE_S)],
    "seconds_by_phase": Annotated[dict[str, Seconds], *_keyed_by(SwapState)],
    "swaps_by_result": Annotated[dict[str, Count], *_keyed_by(SwapResult)],
    "withheld_by_cause": Annotated[dict[str, Count], *_keyed_by(WithheldCause)],
    "refusal_reason": RefusalReason,
    "depth": Annotated[int, Field(ge=1, le=MOST["depth"])],
    "baseline_depth": Annotated[int, Field(ge=1, le=MOST["baseline_depth"])],
    **{name: Annotated[float, Field(ge=0.0, le=most)] for name, most in MOST.items() if isinstance(most, float)},
}


class _Told(BaseModel):
    # Unknown names are ignored: each would be an error to write down, and a message may have 70,000.
    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)


def _kind(each: Any) -> Any:
    return KINDS.get(each.name) or KINDS[each.type]


def _record(kind: Any) -> Any:
    """Return the type of a record of arpd's in a message; fields with a usual value may be missing."""
    told: dict[str, Any] = {}
    for each in fields(kind):
        usual = ... if each.default is MISSING else each.default
        made = each.default_factory
        told[each.name] = _kind(each), usual if made is MISSING else Field(default_factory=made)
    model = create_model(kind.__name__, __base__=_Told, **told)
    return Annotated[model, AfterValidator(lambda found: kind(**vars(found)))]


KINDS["RelayTopics"] = _record(RelayTopics)
KINDS["SwapRecord | None"] = _record(SwapRecord) | None
#: A list for each field; an empty one where all have the usual value.
_COLUMNS: dict[str, Any] = {
    each.name: (Rates if each.name in {"rate_hz", "paced_rate_hz"} else Column[_kind(each)], [])  # type: ignore[misc]
    for each in fields(PublisherState)
    if each.name in TOLD
}
_NEEDED = {"topic", "type_name", "payload_bytes", "source_rate_hz", "depth", "baseline_depth"}
_SNAPSHOT: Any = create_model(
    "snapshot",
    __base__=_Told,
    node=Name,
    publishers=(create_model("publishers", __base__=_Told, **_COLUMNS), ...),
    left_out=(Count, 0),
    answer=(_record(PlanAnswer), NO_PLAN),
    lacks_profile=(bool, False),
    relay=(_record(RelaySummary) | None, None),
    host=(Text, ""),
)


def decode_snapshot(data: bytes) -> NodeSnapshot:
    """Return what a node tells; raises ValueError, which names the value that is missing, malformed or out of range."""
    text = expand(data, most_bytes=MOST_BYTES, likely=LIKELY)
    try:
        told = _SNAPSHOT.model_validate_json(text)
    except ValidationError as faults:
        fault = faults.errors(include_url=False)[0]
        place = ".".join(map(str, fault["loc"]))
        raise ValueError(f"snapshot of a node: {place} = {str(fault['input'])[:40]!r}: {fault['msg']}") from faults
    common = {
        "node": told.node,
        "direction": Direction.LOCAL,  # until the graph shows more
        "generation": told.answer.generation,
        "lease_s": told.answer.lease_s,
        "lacks_profile": told.lacks_profile,
    }
    rows = _rows({name: values for name, values in vars(told.publishers).items() if values}, common)
    of_node = {name: getattr(told, name) for name in ("node", "answer", "left_out", "relay", "host")}
    return NodeSnapshot(**of_node, publishers=rows)


def _rows(columns: dict[str, list[Any]], common: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the fields of each publisher.

    Raises ValueError if the lists are not of one length, or lack a field that has no usual value.
    """
    if columns and not columns.keys() >= _NEEDED:
        raise ValueError(f"publishers lack {', '.join(sorted(_NEEDED - columns.keys()))}")
    withheld = [min(MOST_INTEGER, sum(causes.values())) for causes in columns.get("withheld_by_cause", ())]
    if withheld:
        columns = {**columns, "withheld": withheld}
    return [{**common, **dict(zip(columns, row, strict=True))} for row in zip(*columns.values(), strict=True)]
