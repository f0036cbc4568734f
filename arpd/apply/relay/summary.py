"""Summary of the relay, from the robot's end to the daemon on the same host: a JSON document."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from typing import TYPE_CHECKING, Any

from arpd.model.quantities import printable
from arpd.model.relay import RelaySummary, RelayTopics

if TYPE_CHECKING:
    from arpd.apply.relay.offers import EndState

VERSION = 1
MOST_SUMMARY_BYTES = 1_000_000  # 100 refused topics take 10 kB
_MOST_NAMED = 100  # of each kind
_MOST_TEXT = 300  # characters
_MOST_COUNT = 2**63
_TOPICS = RelayTopics(refused={"": ""})
_EXAMPLE = RelaySummary(
    to_ceddp=_TOPICS, to_robot=_TOPICS, calls_failed={"": 0}, strangers=("",), types_differ={"": ""}
)


def topics_of(sender: EndState, receiver: EndState) -> RelayTopics:
    """Return the topics of one direction.

    An end mostly refuses what would enter its side; only a name that nobody offers there has to leave it.
    """
    entering = {*sender.topics, *sender.services}
    leaving = {*receiver.topics, *receiver.services}
    refused = {name: reason for name, reason in sender.refused.items() if name not in leaving}
    refused |= {name: reason for name, reason in receiver.refused.items() if name in entering}
    return RelayTopics(offered=len(sender.topics), wanted=len(sender.topics.keys() & receiver.wants), refused=refused)


def encode_summary(summary: RelaySummary) -> bytes:
    """Return the summary as JSON, with at most a hundred names of each kind."""
    document = _cut({"version": VERSION, **asdict(summary)})
    return json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()


def decode_summary(data: bytes) -> RelaySummary:
    """Return the summary from its bytes.

    Raises
    ------
    ValueError
        If the bytes are no summary, or one of another version.
    """
    if len(data) > MOST_SUMMARY_BYTES:
        raise ValueError(f"a relay's summary of {len(data)} bytes; at most {MOST_SUMMARY_BYTES} are allowed")
    try:
        document = json.loads(data)
        if (version := document["version"]) != VERSION:
            raise ValueError(f"a relay's summary of version {version!r:.60}; this arpd understands {VERSION}")
        summary: RelaySummary = _like(_EXAMPLE, document)
    except (KeyError, TypeError, RecursionError) as fault:
        raise ValueError(f"no summary of a relay ({fault})") from fault
    return summary


def _cut(found: Any) -> Any:
    """Return a part of a document with fewer and shorter texts, all of them printable."""
    match found:
        case str():
            return printable(found, longest=_MOST_TEXT)
        case dict():
            return {_cut(key): _cut(value) for key, value in sorted(found.items())[:_MOST_NAMED]}
        case tuple():
            return [_cut(each) for each in found[:_MOST_NAMED]]
    return found


def _like(example: Any, found: Any) -> Any:
    """Return a part of a document if it has the types of the example and is not too large."""
    match example:
        case RelaySummary() | RelayTopics():
            parts = {each.name: _like(getattr(example, each.name), found[each.name]) for each in fields(example)}
            return replace(example, **parts)
        case {"": inner} if isinstance(found, dict) and len(found) <= _MOST_NAMED:
            return {_like("", name): _like(inner, value) for name, value in found.items()}
        case (inner,) if isinstance(found, list) and len(found) <= _MOST_NAMED:
            return tuple(_like(inner, each) for each in found)
        case str() if isinstance(found, str) and len(found) <= _MOST_TEXT and found.isprintable():
            return found
        case int() if type(found) is type(example) and 0 <= found < _MOST_COUNT:
            return found
    raise ValueError(f"a relay's summary with {found!r:.60} where {example!r:.20} is an example")
