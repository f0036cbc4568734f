"""Snapshot of a node, which it sends the daemon once a second: its publishers, its plan, and a relay's summary. Pure.

A document with everything, so that each message stands alone. What has its usual value is left out: keys of the head,
and the end of a list.
"""

from __future__ import annotations

import math
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from arpd.model.endpoints import (
    Direction,
    NodeSnapshot,
    RefusalReason,
    SwapPhase,
    SwapRecord,
    SwapResult,
    WithheldCause,
)
from arpd.model.plan import MOST_GENERATION, NO_PLAN, PlanAnswer
from arpd.model.quantities import printable
from arpd.model.relay import RelaySummary, RelayTopics
from arpd.ros.bounds import MOST_LEASE_S
from arpd.ros.documents import MOST_INTEGER, integer, number, pack, unpack
from arpd.ros.names import is_full_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from enum import StrEnum

    from arpd.model.endpoints import PublisherState

MOST_OF_NODE = 256  # publishers of a node: more than any relay carries
MOST_BYTES = 1_000_000  # of a snapshot's text; 256 publishers take 100 kB, and 100 refused topics of a relay 10 kB
MOST_WORDS = 300  # characters of a refusal
_MOST_DEPTH = 100_000
_MOST_HZ = 1e5  # of a source
_MOST_SECONDS = 1e9  # 30 years
_MOST_PAYLOAD = float(2**30)  # too large for any link that needs arpd
_MOST_NAMED = 100  # names of each kind in a relay's summary


# -- values, and records of them


class _Column(NamedTuple):
    """One value of a record: the usual one, what reads it by name, and what makes it JSON."""

    usual: Any
    read: Callable[[str, Any], Any]
    shown: Callable[[Any], Any] = lambda value: value


def _number(usual: float, most: float) -> _Column:
    # One value that a daemon refuses would silence the whole node, so it is cut to the bounds here. Six digits do.
    return _Column(
        usual,
        partial(number, most=most),
        lambda value: float(f"{min(value, most):.6g}") if math.isfinite(value) else None,
    )


def _integer(least: int = 0, most: int = MOST_INTEGER) -> _Column:
    return _Column(0, partial(integer, least=least, most=most), lambda value: max(least, min(value, most)))


def _one_of(names: type[StrEnum], usual: StrEnum) -> _Column:
    def read(name: str, value: Any) -> StrEnum:
        try:
            return names(value)
        except ValueError as fault:
            raise ValueError(f"{name} = {str(value)[:40]!r} is none of {', '.join(sorted(names))}") from fault

    return _Column(usual, read)


def _read_name(name: str, value: Any) -> str:
    if not isinstance(value, str) or not is_full_name(value):
        raise ValueError(f"{name} = {str(value)[:80]!r} is no fully qualified ROS name")
    return value


def _read_text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} = {str(value)[:40]!r} is no text")  # noqa: TRY004 - a message may hold anything
    return _plain(value)


def _plain(text: str) -> str:
    is_plain = len(text) <= MOST_WORDS and text.isprintable()
    return text if is_plain else printable(text, longest=MOST_WORDS)


def _read_flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{name} = {str(value)[:40]!r} is neither true nor false")  # noqa: TRY004 - as above
    return value


def _mapping(column: _Column, names: Iterable[StrEnum] | None = None) -> _Column:
    """Return a column of values by name; where each name becomes a label of a metric, only known ones are read."""
    known = None if names is None else {name.value for name in names}

    def read(name: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict) or len(value) > _MOST_NAMED or (known is not None and value.keys() - known):
            raise ValueError(f"{name} = {str(value)[:40]!r} has not the values by name that are known")
        return {_plain(key): column.read(name, each) for key, each in value.items()}

    def shown(value: Mapping[str, Any]) -> dict[str, Any]:
        return {_plain(key): column.shown(each) for key, each in sorted(value.items())[:_MOST_NAMED]}

    return _Column({}, read, shown)


def _list(column: _Column) -> _Column:
    def read(name: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or len(value) > _MOST_NAMED:
            raise ValueError(f"{name} = {str(value)[:40]!r} is no list of at most {_MOST_NAMED}")
        return tuple(column.read(name, each) for each in value)

    return _Column((), read, lambda value: [column.shown(each) for each in value[:_MOST_NAMED]])


def _record(kind: Callable[..., Any], least: int = 0, /, **columns: _Column) -> _Column:
    """Return a column of lists: values in this order, up to the last one that is not the usual one.

    Parameters
    ----------
    kind : makes the record from its values by name
    least : values that are always there
    """
    usual = {name: column.usual for name, column in columns.items()}
    readers = tuple((name, column.read) for name, column in columns.items())
    shown_by = tuple(column.shown for column in columns.values())
    values_of = attrgetter(*columns)

    def read(name: str, value: Any) -> Any:
        if value is None:
            return None
        if not isinstance(value, list) or not least <= len(value) <= len(columns):
            raise ValueError(f"{name} = {str(value)[:40]!r} has not the values {', '.join(columns)}")
        found = {each: read_by(each, one) for (each, read_by), one in zip(readers, value, strict=False)}
        return kind(**{**usual, **found})

    def shown(record: Any) -> list[Any] | None:
        if record is None:
            return None
        values = values_of(record)
        size = len(values)
        for value in reversed(usual.values()):
            if size == least or values[size - 1] != value:
                break
            size -= 1
        return [show(value) for show, value in zip(shown_by, values[:size], strict=False)]

    return _Column(None, read, shown)


_COUNT, _SECONDS = _integer(), _number(0.0, _MOST_SECONDS)
_NAME, _TEXT, _FLAG = _Column("", _read_name), _Column("", _read_text, _plain), _Column(usual=False, read=_read_flag)
_PHASES, _RESULT = _mapping(_SECONDS, SwapPhase), _one_of(SwapResult, SwapResult.OK)
_GENERATION = _integer(most=MOST_GENERATION)
_SWAP = _record(
    SwapRecord,
    5,
    number=_COUNT,
    result=_RESULT,
    depth=_COUNT,
    deadline_ns=_COUNT,
    seconds_by_phase=_PHASES,
)
_PUBLISHER = _record(
    dict,
    4,
    topic=_NAME,
    type_name=_TEXT,
    baseline_depth=_integer(1, _MOST_DEPTH),
    depth=_integer(1, _MOST_DEPTH),
    offered=_COUNT,
    published=_COUNT,
    payload_bytes=_number(0.0, _MOST_PAYLOAD),
    source_rate_hz=_number(0.0, _MOST_HZ),
    published_rate_hz=_number(0.0, _MOST_HZ),
    rate_hz=_number(math.inf, math.inf),
    paced_rate_hz=_number(math.inf, math.inf),
    deadline_ns=_COUNT,
    blocked_s=_SECONDS,
    withheld_by_cause=_mapping(_COUNT, WithheldCause),
    queued=_COUNT,
    swaps_begun=_COUNT,
    swaps_by_result=_mapping(_COUNT, SwapResult),
    swap_seconds_by_phase=_PHASES,
    last_swap=_SWAP,
    baseline_deadline_ns=_COUNT,
    deadlines_missed=_COUNT,
    keeps_all=_FLAG,
    refusal_reason=_one_of(RefusalReason, RefusalReason.NONE),
    refusal=_TEXT,
)
_ANSWER = _record(
    PlanAnswer, generation=_GENERATION, lease_s=_number(0.0, MOST_LEASE_S), refused=_GENERATION, refusal=_TEXT
)
_TOPICS = _record(RelayTopics, offered=_COUNT, wanted=_COUNT, refused=_mapping(_TEXT))._replace(usual=RelayTopics())
_RELAY = _record(
    RelaySummary,
    other_host=_TEXT,
    is_reachable=_FLAG,
    fault=_TEXT,
    to_base=_TOPICS,
    to_robot=_TOPICS,
    received=_COUNT,
    doubled=_COUNT,
    unknown=_COUNT,
    outdated=_COUNT,
    link_bytes=_COUNT,
    incomplete=_COUNT,
    calls_failed=_mapping(_COUNT),
    strangers=_list(_TEXT),
    types_differ=_mapping(_TEXT),
)


# -- the whole


def encode_snapshot(
    node: str,
    states: Iterable[PublisherState],
    *,
    answer: PlanAnswer = NO_PLAN,
    lacks_profile: bool = False,
    relay: RelaySummary | None = None,
) -> bytes:
    """Return a node's message.

    Parameters
    ----------
    states : of its publishers
    lacks_profile : whether its process runs without arpd's Fast DDS profile
    """
    document: dict[str, Any] = {"node": node}
    if rows := [_PUBLISHER.shown(state) for state in states]:
        document["publishers"] = rows
    if answer != NO_PLAN:
        document["answer"] = _ANSWER.shown(answer)
    if lacks_profile:
        document["lacks_profile"] = True
    if relay is not None:
        document["relay"] = _RELAY.shown(relay)
    return pack(document)


def decode_snapshot(data: bytes) -> NodeSnapshot:
    """Return what a node tells, every value checked.

    Raises
    ------
    ValueError
        If a value is missing, malformed or out of range; the message names node, topic and value.
    """
    document = unpack(data, most_bytes=MOST_BYTES)
    node = _read_name("node", document.get("node"))
    try:
        return _read(node, document)
    except ValueError as fault:
        raise ValueError(f"snapshot of {node}: {fault}") from fault


def _read(node: str, document: Mapping[str, Any]) -> NodeSnapshot:
    rows = document.get("publishers", [])
    if not isinstance(rows, list) or len(rows) > MOST_OF_NODE or None in rows:
        raise ValueError(f"it has no list of at most {MOST_OF_NODE} publishers")
    answer = _ANSWER.read("answer", document.get("answer")) or NO_PLAN
    common = {
        "node": node,
        "direction": Direction.LOCAL,  # until the graph shows more
        "generation": answer.generation,
        "lease_s": answer.lease_s,
        "lacks_profile": _read_flag("lacks_profile", document.get("lacks_profile", False)),
    }
    publishers = []
    for row in rows:
        found = _PUBLISHER.read("a publisher", row)
        withheld = min(MOST_INTEGER, sum(found["withheld_by_cause"].values()))
        publishers.append({**common, **found, "withheld": withheld})
    relay = _RELAY.read("relay", document.get("relay"))
    return NodeSnapshot(node=node, answer=answer, publishers=publishers, relay=relay)
