"""The plan of one node as a message, and the node's answer to it: pure."""

from __future__ import annotations

import json
import math
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from arpd.adapters.ros.names import is_full_name
from arpd.model.plan import MOST_GENERATION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.plan import TopicPlan

_VERSION = 2
PUBLISHER_FIELDS = ("depth", "deadline_ns", "rate_hz", "min_rate_hz", "weight", "wire_bytes", "packets")
_INTEGERS = frozenset({"depth", "deadline_ns", "packets"})
MOST_WORDS = 300  # characters of a refusal
_MOST_BYTES = 1 << 20  # a thousand topics take a tenth of it


class PlanAnswer(NamedTuple):
    """A node's answer to a plan: that it is in force, or why it is refused.

    Parameters
    ----------
    generation : of the plan in force, 0 = none
    crc : hash of the message that was answered, 0 = none came yet
    refusal : why that message was refused, empty = it was taken
    """

    generation: int = 0
    crc: int = 0
    refusal: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class NodePlan:
    """All rows that are now asked of one node.

    Parameters
    ----------
    generation : number of the plan
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    publishers : topic → fields of its row, by name; those without a row stay as they are
    """

    generation: int
    lease_s: float = 0.0
    publishers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def encode_plan(*, generation: int, lease_s: float, publishers: Mapping[str, TopicPlan]) -> str:
    """Return the text of a plan; the same plan has the same text."""
    document = {
        "version": _VERSION,
        "generation": generation,
        "lease_s": lease_s,
        "publishers": {topic: _row(row) for topic, row in sorted(publishers.items())},
    }
    return json.dumps(document, separators=(",", ":"), allow_nan=False)


def plain(text: str, most: int) -> str:
    """Cut a text of a stranger short, and replace characters that would act on a terminal or a log."""
    return "".join(character if character.isprintable() else "?" for character in text[:most])


def crc_of(text: str) -> int:
    """Return the hash by which a node names the message that it answers."""
    return zlib.crc32(text.encode(errors="replace"))


def decode_plan(text: str) -> NodePlan:
    """Read a plan; the bounds of its numbers are the endpoints' matter.

    Raises
    ------
    ValueError
        If the text is no plan; the message names the fault.
    """
    if len(text) > _MOST_BYTES:
        raise ValueError(f"a plan of {len(text)} characters; at most {_MOST_BYTES} are read")
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as fault:
        raise ValueError(f"a plan that is no JSON: {fault}") from fault
    if not isinstance(document, dict) or document.get("version") != _VERSION:
        raise ValueError(f"a plan of another version than {_VERSION}")
    generation = _number("generation", document.get("generation"), is_integer=True)
    if not 0 <= generation <= MOST_GENERATION:
        raise ValueError(f"a plan of generation {generation}, which is not from 0 to {MOST_GENERATION}")
    return NodePlan(
        generation=generation,
        lease_s=_number("lease_s", document.get("lease_s"), is_integer=False),
        publishers=_rows(document.get("publishers")),
    )


def _row(row: TopicPlan) -> list[float | None]:
    return [None if (value := getattr(row, name)) == math.inf else value for name in PUBLISHER_FIELDS]


def _rows(rows: Any) -> dict[str, dict[str, Any]]:
    if not isinstance(rows, dict):
        raise ValueError("a plan without rows")  # noqa: TRY004 - a message may hold anything, so it is no type error
    names, found = PUBLISHER_FIELDS, {}
    for topic, row in rows.items():
        if not is_full_name(topic) or not isinstance(row, list) or len(row) != len(names):
            raise ValueError(f"a plan with a row of {topic[:80]!r} that has not the numbers {', '.join(names)}")
        found[topic] = {
            name: _number(name, value, is_integer=name in _INTEGERS) for name, value in zip(names, row, strict=True)
        }
    return found


def _number(name: str, value: Any, *, is_integer: bool) -> Any:
    if is_integer and isinstance(value, int) and not isinstance(value, bool):
        return value
    if not is_integer and value is None and name == "rate_hz":
        return math.inf
    if not is_integer and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            pass
    raise ValueError(f"a plan with {name} = {str(value)[:40]!r}")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")
