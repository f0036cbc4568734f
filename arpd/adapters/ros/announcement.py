"""Announcements of live publishers, to and from diagnostic_msgs.

A daemon ignores unknown keys, and keys added after the first version may be missing.
"""

from __future__ import annotations

import math
import re
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from arpd.adapters.ros.bounds import MOST_LEASE_S
from arpd.adapters.ros.counters import MOST_INTEGER
from arpd.adapters.ros.names import is_full_name
from arpd.adapters.ros.plan_message import plain
from arpd.model.endpoints import (
    Direction,
    PublisherState,
    RefusalReason,
    SwapPhase,
    SwapRecord,
    WithheldCause,
)
from arpd.model.plan import MOST_GENERATION
from arpd.observe.registry import Tag

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from enum import StrEnum

_WRITER_RESULTS = "swaps_"
_CAUSES = "withheld_by_cause"
_PHASES = "swap_seconds_by_phase"
_BEGUN = "begun_swaps"  # not "swaps_…": an older daemon would read that as a result
_LAST_RESULT = "last_swap"
_MISSED = "deadlines_missed"
_PUBLISHED_RATE = "published_rate_hz"
_PACED_RATE = "paced_rate_hz"
_KEEP_ALL = "keep_all"
_TAG = "announcer"
_TAG_WORDS = re.compile(r"([0-9a-f]{1,16}) ([0-9]{1,10}) ([0-9]{1,3})", re.ASCII)
_PROFILE, _MISSING = "profile", "missing"
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
_MOST_SECONDS = 1e9  # 30 years
_MOST_FLOATS = {
    "payload_bytes": float(2**30),  # too large for any link that needs arpd
    "source_rate_hz": 1e5,
    _PUBLISHED_RATE: 1e5,
    "blocked_s": _MOST_SECONDS,
    "rate_hz": math.inf,
    _PACED_RATE: math.inf,
    "lease_s": MOST_LEASE_S,
}
_MOST_DEPTH = 100_000
_MOST_RESULTS = 32  # of swaps; each becomes a label of a metric
_MAX_RESULT = 40
_MAX_NAME = 256
MOST_VALUES = 128  # pairs in one status

N = TypeVar("N", int, float)


def to_status(state: PublisherState, tag: Tag | None = None) -> Any:
    """Encode one publisher as a DiagnosticStatus; diagnostics viewers show a refusal as WARN.

    Parameters
    ----------
    tag : by which later messages of numbers name this status
    """
    values = [] if tag is None else [(_TAG, f"{tag.incarnation:x} {tag.number} {tag.serial}")]
    values += [("node", state.node), ("topic", state.topic), ("type", state.type_name), ("refusal", state.refusal)]
    values += _remarks(state)
    values += [(key, f"{getattr(state, key):.6g}") for key in _FLOATS]
    values += [(key, str(getattr(state, key))) for key in _INTEGERS]
    values += [(_WRITER_RESULTS + result, str(count)) for result, count in sorted(state.swaps_by_result.items())]
    values += _account(state)
    return _status(state, values, warning=state.refusal, summary=f"{state.rate_hz:.3g} Hz, depth {state.depth}")


def tag_of(status: Any) -> Tag | None:
    """Return the tag of a publisher's announcement, None if it has none.

    Raises
    ------
    ValueError
        If it is malformed.
    """
    words = _value(status, _TAG)
    if words is None:
        return None
    found = _TAG_WORDS.fullmatch(words)
    if found is None:
        raise ValueError(f"announcement with {_TAG} = {words[:40]!r}")
    return Tag(int(found[1], 16), int(found[2]), int(found[3]))


def from_status(status: Any) -> PublisherState:
    """Decode one publisher's announcement, and check every field.

    Raises
    ------
    ValueError
        If a field is missing, malformed or out of range; the message names it.
    """
    values, fields = _fields(status, texts=("node", "topic", "type"), floats=_FLOATS, integers=_INTEGERS)
    return PublisherState(
        type_name=plain(fields.pop("type"), _MAX_NAME),
        direction=Direction.LOCAL,
        lacks_profile=values.get(_PROFILE) == _MISSING,
        published_rate_hz=_number(_PUBLISHED_RATE, values.get(_PUBLISHED_RATE, "0")),
        paced_rate_hz=_number(_PACED_RATE, values.get(_PACED_RATE, values["rate_hz"])),
        swaps_by_result=_counts(values, _WRITER_RESULTS),
        withheld_by_cause=_by_name(_CAUSES, values.get(_CAUSES, "").split(), WithheldCause, _bounded),
        swaps_begun=_bounded(_BEGUN, values.get(_BEGUN, "0")),
        swap_seconds_by_phase=_by_name(_PHASES, values.get(_PHASES, "").split(), SwapPhase, _seconds),
        last_swap=_record(values[_LAST_RESULT]) if _LAST_RESULT in values else None,
        **fields,
    )


def _value(status: Any, key: str) -> str | None:
    return next((str(pair.value) for pair in status.values if pair.key == key), None)


def _status(state: PublisherState, values: list[tuple[str, str]], *, warning: str, summary: str) -> Any:
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if warning else DiagnosticStatus.OK,
        name=f"{state.node}: {state.topic}",
        message=warning or summary,
        hardware_id="",
        values=[KeyValue(key=key, value=value) for key, value in values],
    )


def _fields(
    status: Any, *, texts: Iterable[str], floats: Iterable[str], integers: Iterable[str]
) -> tuple[Mapping[str, str], dict[str, Any]]:
    """Return all pairs as they came, and the checked fields."""
    if len(status.values) > MOST_VALUES:
        raise ValueError(f"announcement with {len(status.values)} values; at most {MOST_VALUES} are allowed")
    values = {pair.key: pair.value for pair in status.values}
    try:
        fields: dict[str, Any] = {key: values[key] for key in texts}
        fields |= {key: _number(key, values[key]) for key in floats}
        fields |= {key: _bounded(key, values[key]) for key in integers}
    except KeyError as missing:
        raise ValueError(f"announcement without {missing}") from missing
    _check(fields)
    refusal = plain(values.get("refusal", ""), _MAX_NAME)
    reason = RefusalReason.told(values.get("refusal_reason"), words=refusal)
    return values, {
        **fields,
        "refusal": refusal,
        "refusal_reason": reason,
        "keeps_all": values.get("history") == _KEEP_ALL,
        "deadlines_missed": _bounded(_MISSED, values.get(_MISSED, "0")),
    }


def _remarks(state: PublisherState) -> list[tuple[str, str]]:
    """Return the pairs that only some endpoints announce."""
    refused = [("refusal_reason", str(state.refusal_reason))] if state.refusal else []
    return [*refused, ("history", _KEEP_ALL)] if state.keeps_all else refused


def _account(state: PublisherState) -> list[tuple[str, str]]:
    """Return the pairs that explain rate and counters; those that would say nothing are left out."""
    is_slowed = state.paced_rate_hz != state.rate_hz
    values = [(_PACED_RATE, f"{state.paced_rate_hz:.6g}")] if is_slowed else []
    values += [(_PROFILE, _MISSING)] if state.lacks_profile else []
    values += [(_PUBLISHED_RATE, f"{state.published_rate_hz:.6g}")] if state.published_rate_hz else []
    values += [(_CAUSES, _words(state.withheld_by_cause))] if state.withheld_by_cause else []
    values += [(_MISSED, str(state.deadlines_missed))] if state.deadlines_missed else []
    if state.swaps_begun:
        values += [(_BEGUN, str(state.swaps_begun)), (_PHASES, _words(state.swap_seconds_by_phase))]
    if (last := state.last_swap) is not None:
        what = f"{last.number} {last.result} {last.depth} {last.deadline_ns} "
        values += [(_LAST_RESULT, what + _words(last.seconds_by_phase))]
    return values


def _words(numbers: Mapping[str, float]) -> str:
    # In one value, because each value costs a dozen bytes more.
    shown = ((name, number if isinstance(number, int) else f"{number:.6g}") for name, number in numbers.items())
    return " ".join(f"{name}={number}" for name, number in shown)


def _record(text: str) -> SwapRecord:
    """Decode the last swap: its number, result, depth and deadline, and the seconds of its phases by name."""
    number, result, depth, deadline_ns, *phases = [*text[:_MAX_NAME].split(), "", "", "", ""]
    return SwapRecord(
        number=_bounded(_LAST_RESULT, number),
        result=plain(result, _MAX_RESULT),
        depth=_bounded(_LAST_RESULT, depth),
        deadline_ns=_bounded(_LAST_RESULT, deadline_ns),
        seconds_by_phase=_by_name(_LAST_RESULT, phases, SwapPhase, _seconds),
    )


def _by_name(key: str, words: Iterable[str], names: Iterable[StrEnum], read: Callable[[str, str], N]) -> dict[str, N]:
    """Return the numbers with known names; each name becomes a label of a metric."""
    found = dict(word.partition("=")[::2] for word in words)
    return {name.value: read(key, found[name]) for name in names if name in found}


def _counts(values: Mapping[str, str], prefix: str) -> dict[str, int]:
    found = ((key, value) for key, value in values.items() if key.startswith(prefix))
    return {
        plain(key.removeprefix(prefix), _MAX_RESULT): _bounded(key, value)
        for key, value in islice(found, _MOST_RESULTS)
    }


def _check(fields: Mapping[str, Any]) -> None:
    node, topic = fields["node"], fields["topic"]
    for name in (node, topic):
        if not is_full_name(name):
            raise ValueError(f"announcement with the name {name[:80]!r}; a fully qualified ROS name is needed")
    if not 1 <= fields["depth"] <= _MOST_DEPTH or not 1 <= fields["baseline_depth"] <= _MOST_DEPTH:
        raise ValueError(f"announcement of {topic} with a depth outside 1..{_MOST_DEPTH}")
    if fields["generation"] > MOST_GENERATION:
        raise ValueError(f"announcement of {topic} with generation {fields['generation']}, above {MOST_GENERATION}")


def _number(key: str, text: str) -> float:
    return _up_to(_MOST_FLOATS[key], key, text)


def _seconds(key: str, text: str) -> float:
    return _up_to(_MOST_SECONDS, key, text)


def _up_to(most: float, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= most:
        raise ValueError(f"announcement with {key} = {text[:40]!r}; a number from 0 to {most:g} is needed")
    return value


def _bounded(key: str, text: str) -> int:
    try:
        value = int(text[:40])  # a longer text is out of range, and slow to convert
    except ValueError:
        value = -1
    if not 0 <= value <= MOST_INTEGER:
        raise ValueError(f"announcement with {key} = {text[:40]!r}; an integer from 0 to 2^63-1 is needed")
    return value
