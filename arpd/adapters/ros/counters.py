"""Wire format of the numbers that a node tells once a second: pure.

A status on ``/arpd/publishers`` has all there is to know of a publisher. Between two statuses a row of
``/arpd/counters`` has the numbers that changed since, in 7 bytes and 4 more for each number.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from arpd.adapters.ros.bounds import MOST_LEASE_S
from arpd.adapters.ros.names import is_full_name
from arpd.adapters.ros.plan_message import MOST_WORDS, PlanAnswer, plain
from arpd.model.endpoints import PublisherState, WithheldCause
from arpd.model.plan import MOST_GENERATION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

_VERSION = 1
# Version, incarnation, generation, hash of the plan, lease s, rows, bytes of the node's name, bytes of the refusal.
_HEAD = struct.Struct("<BQQIdHHH")
_ROW = struct.Struct("<IBH")  # number of the publisher, serial of its last status, mask of the numbers that follow
_SUMS = ("offered", "published", "deadlines_missed")  # grow only; told as what they grew by since the status
_CAUSES = tuple(cause.value for cause in WithheldCause)  # the same, of ``withheld_by_cause``, whose sum is ``withheld``
_MOST_HZ = 1e5  # of a source
_MOST_SECONDS = 1e9  # 30 years
_INFINITY = float("inf")
_LEVELS = {  # field → greatest value
    "source_rate_hz": _MOST_HZ,
    "published_rate_hz": _MOST_HZ,
    "paced_rate_hz": _INFINITY,
    "rate_hz": _INFINITY,
    "payload_bytes": float(2**30),
    "blocked_s": _MOST_SECONDS,
}
_QUEUED = "queued"
_FORMATS = "I" * len(_SUMS + _CAUSES) + "I" + "f" * len(_LEVELS)
NUMBERS = frozenset((*_SUMS, "withheld", "withheld_by_cause", _QUEUED, *_LEVELS))
_sums_of = attrgetter(*_SUMS)
_levels_of = attrgetter(_QUEUED, *_LEVELS)
_MOST_F32 = 3.4e38  # a float of 32 bits holds no more
_MOST_U32 = 2**32 - 1
MOST_INTEGER = 2**63 - 1
_MASKS = 1000  # that the caches keep; honest nodes use a few dozen
MOST_COUNTERS_BYTES = 24 * 1024  # of a message: 256 rows with all numbers


class Row(NamedTuple):
    """What a publisher told: its number, the serial of its last status, and which numbers changed since that."""

    number: int
    serial: int
    mask: int
    values: tuple[Any, ...]

    def changes(self, told: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields that changed since a status, from the fields of that status."""
        found: dict[str, Any] = {}
        values = iter(self.values)
        sums, causes, levels = _fields_of(self.mask)
        for name in sums:
            found[name] = min(told[name] + next(values), MOST_INTEGER)
        if causes:
            by_cause, withheld = dict(told["withheld_by_cause"]), told["withheld"]
            for cause in causes:
                more = next(values)
                by_cause[cause] = min(by_cause.get(cause, 0) + more, MOST_INTEGER)
                withheld += more
            found["withheld_by_cause"], found["withheld"] = by_cause, min(withheld, MOST_INTEGER)
        found.update(zip(levels, values, strict=True))
        return found


@dataclass(frozen=True, kw_only=True, slots=True)
class Counters:
    """Everything one node tells once a second.

    Parameters
    ----------
    node : its full name
    incarnation : random number of this life of the node
    answer : the node's answer to its last plan for publishers
    lease_s : silence of the daemon after which the node returns to its own QoS, 0 = never (s)
    rows : one for each live publisher
    """

    node: str
    incarnation: int
    answer: PlanAnswer
    lease_s: float
    rows: Sequence[Row]


def row_of(number: int, serial: int, *, told: PublisherState, now: PublisherState) -> bytes:
    """Encode the row of one publisher from its last status and its state now."""
    mask, bit, values = 0, 1, []
    before, after = told.withheld_by_cause, now.withheld_by_cause
    grown = [new - old for old, new in zip(_sums_of(told), _sums_of(now), strict=True)]
    grown += [after.get(cause, 0) - before.get(cause, 0) for cause in _CAUSES]
    for value in grown:
        if value > 0:
            mask |= bit
            values.append(min(value, _MOST_U32))
        bit <<= 1
    for old, new, most in zip(_levels_of(told), _levels_of(now), (_MOST_U32, *_LEVELS.values()), strict=True):
        if old != new:
            mask |= bit
            value = min(new, most)  # one number that a daemon refuses would silence the whole node
            values.append(value if value <= _MOST_F32 else _INFINITY)
        bit <<= 1
    return _ROW.pack(number, serial, mask) + _format_of(mask).pack(*values)


def encode_counters(node: str, rows: Iterable[bytes], *, incarnation: int, answer: PlanAnswer, lease_s: float) -> bytes:
    """Encode the message of one node."""
    rows, name, words = list(rows), node.encode(), answer.refusal[:MOST_WORDS].encode()
    head = _HEAD.pack(_VERSION, incarnation, answer.generation, answer.crc, lease_s, len(rows), len(name), len(words))
    return b"".join((head, name, words, *rows))


def sender_of(data: bytes) -> str:
    """Return the name of the node that sent a message; it takes 1 µs.

    Raises
    ------
    ValueError
        If the bytes are no such message.
    """
    if len(data) < _HEAD.size or data[0] != _VERSION:
        raise ValueError("counters of another version, or cut off")
    size = _HEAD.unpack_from(data)[-2]
    try:
        node = data[_HEAD.size : _HEAD.size + size].decode()
    except UnicodeDecodeError as fault:
        raise ValueError("counters of a node without a name") from fault
    if not is_full_name(node):
        raise ValueError("counters of a node without a name")
    return node


def decode_counters(data: bytes) -> Counters:
    """Decode a message, and check every number.

    Raises
    ------
    ValueError
        If it is malformed or a number is out of range.
    """
    node = sender_of(data)
    _, incarnation, generation, crc, lease_s, count, name, words = _HEAD.unpack_from(data)
    if not 0.0 <= lease_s <= MOST_LEASE_S or generation > MOST_GENERATION:
        raise ValueError(f"counters of {node} with a lease or a generation out of bounds")
    at = _HEAD.size + name
    refusal = plain(data[at : at + words].decode(errors="replace"), MOST_WORDS)
    at += words
    rows = []
    try:
        for _ in range(count):
            number, serial, mask = _ROW.unpack_from(data, at)
            form = _format_of(mask)
            rows.append(Row(number, serial, mask, form.unpack_from(data, at + _ROW.size)))
            at += _ROW.size + form.size
    except struct.error as fault:
        raise ValueError(f"counters of {node} are cut off") from fault
    if at != len(data):
        raise ValueError(f"counters of {node} with bytes that belong to no row")
    _check(node, rows)
    answer = PlanAnswer(generation=generation, crc=crc, refusal=refusal)
    return Counters(node=node, incarnation=incarnation, answer=answer, lease_s=lease_s, rows=rows)


def _check(node: str, rows: Iterable[Row]) -> None:
    for row in rows:
        most = _most_of(row.mask)
        for value, greatest in zip(row.values[len(row.values) - len(most) :], most, strict=True):
            if not 0.0 <= value <= greatest:  # not so NaN
                raise ValueError(f"counters of {node} with the number {value:g}, which is not from 0 to {greatest:g}")


@lru_cache(maxsize=_MASKS)
def _format_of(mask: int) -> struct.Struct:
    return struct.Struct("<" + "".join(form for bit, form in enumerate(_FORMATS) if mask >> bit & 1))


@lru_cache(maxsize=_MASKS)
def _fields_of(mask: int) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Return the sums, causes and levels that a mask names."""
    names = (*_SUMS, *_CAUSES, _QUEUED, *_LEVELS)
    first, second = len(_SUMS), len(_SUMS) + len(_CAUSES)
    named = [(bit, name) for bit, name in enumerate(names) if mask >> bit & 1]
    return (
        tuple(name for bit, name in named if bit < first),
        tuple(name for bit, name in named if first <= bit < second),
        tuple(name for bit, name in named if second <= bit),
    )


@lru_cache(maxsize=_MASKS)
def _most_of(mask: int) -> tuple[float, ...]:
    """Return the greatest values of the rates, sizes and times that a mask names, which come last."""
    return tuple(_LEVELS[name] for name in _fields_of(mask)[2] if name in _LEVELS)
