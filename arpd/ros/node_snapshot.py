"""Snapshot of a node, which it sends the daemon once a second: its publishers, its plan, and a relay's summary. Pure.

A document with everything, so that each message stands alone. Of its publishers it has a list for each field, without
fields of which all have the usual value; of other records, the values that are not the usual ones. The daemon reads it
with `arpd.ros.snapshot_decoder`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from arpd.model.endpoints import MOST_PUBLISHERS, PublisherState, SwapResult, SwapState, WithheldCause
from arpd.model.plan import NO_PLAN, PlanAnswer
from arpd.model.quantities import printable
from arpd.ros.documents import MOST_INTEGER, pack

if TYPE_CHECKING:
    from arpd.model.relay import RelaySummary

#: Of a snapshot's text: twice what as many publishers take whose names, types and refusals are as long as they may be.
MOST_BYTES = 2500 * MOST_PUBLISHERS
LONGEST_SNAPSHOT = MOST_BYTES // 4  # bytes; names at random can be packed to three quarters, and all else to little
MOST_WORDS = 300  # characters of a text
MOST_NAMED = 100  # names of each kind in a relay's summary
MOST_SECONDS = 1e9  # 30 years
#: Most of some values; those of a topic above them do not fit any link that needs arpd.
MOST = {
    "depth": 100_000,
    "baseline_depth": 100_000,
    "payload_bytes": float(2**30),
    "source_rate_hz": 1e5,
    "published_rate_hz": 1e5,
}
#: Fields of a publisher that come from the node, the graph or the time of arrival.
JOINED = {
    *("node", "direction", "generation", "lease_s", "lacks_profile", "withheld"),
    *("remote_readers", "requested_deadline_ns", "announced_at_s"),
}


def encode_snapshot(
    node: str,
    states: Iterable[PublisherState],
    *,
    left_out: int = 0,
    answer: PlanAnswer = NO_PLAN,
    lacks_profile: bool = False,
    relay: RelaySummary | None = None,
    host: str = "",
) -> bytes:
    """Return a node's message, with the states of its publishers, `MOST_PUBLISHERS` at most."""
    document: dict[str, Any] = {"node": node, "publishers": _columns_of(tuple(states))}
    if left_out:
        document["left_out"] = left_out
    if answer != NO_PLAN:
        document["answer"] = {**dataclasses.asdict(answer), "refusal": shown_words(answer.refusal)}
    if lacks_profile:
        document["lacks_profile"] = True
    if host:
        document["host"] = host
    if relay is not None:
        document["relay"] = _shown(relay)
    return pack(document, likely=LIKELY)


def shown_words(text: str) -> str:
    """Return a text of bounded length that people can read."""
    is_plain = len(text) <= MOST_WORDS and text.isprintable()
    return text if is_plain else printable(text, longest=MOST_WORDS)


def _columns_of(states: Sequence[PublisherState]) -> dict[str, list[Any]]:
    columns = {}
    for name, usual in TOLD.items():
        values = [getattr(state, name) for state in states]
        if values.count(usual) < len(values):
            most = MOST.get(name, MOST_SECONDS)
            columns[name] = [_value(value, most) for value in values]
    return columns


def _shown(record: Any) -> dict[str, Any]:
    kind: Any = type(record)
    usual = _usual(kind)
    values = {name: getattr(record, name) for name in usual}
    return {name: _value(value, MOST.get(name, MOST_SECONDS)) for name, value in values.items() if value != usual[name]}


@cache
def _usual(kind: Any) -> dict[str, Any]:
    return {
        each.name: each.default if each.default_factory is dataclasses.MISSING else each.default_factory()
        for each in dataclasses.fields(kind)
    }


def _value(value: Any, most: float = MOST_SECONDS) -> Any:
    # One value that a daemon refuses would silence the whole node, so it is cut to the bounds here. Six digits do.
    if isinstance(value, str):
        return shown_words(value)
    if isinstance(value, float):
        return float(f"{min(value, most):.6g}") if value < math.inf else None
    if isinstance(value, int):
        return value if isinstance(value, bool) else min(value, MOST_INTEGER if most == MOST_SECONDS else int(most))
    if isinstance(value, Mapping):
        return {shown_words(name): _value(each) for name, each in sorted(value.items())[:MOST_NAMED]}
    if isinstance(value, tuple):
        return [_value(each) for each in value[:MOST_NAMED]]
    return None if value is None else _shown(value)


#: Fields that a snapshot has of a publisher, and their usual values.
TOLD = {name: usual for name, usual in _usual(PublisherState).items() if name not in JOINED}
#: Names that a snapshot has, the most likely ones last.
_NAMES = ("relay", *SwapState, *SwapResult, *WithheldCause, *TOLD)
LIKELY = "".join(f'"{name}":[' for name in _NAMES).encode()
