"""Bounds of what a plan may ask of a publisher, and a user; pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from arpd.model.plan import TopicPlan
from arpd.ros.documents import integer, number
from arpd.ros.names import INFINITE_NS

if TYPE_CHECKING:
    from arpd.model.endpoints import WriterQos

MOST_DEPTH = 5000
# No topic that crosses a link is faster than 100 kHz. The timer of a deadline much shorter than the source's period
# takes a tenth of a core (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
_MOST_RATE_HZ = 1e6
LEAST_LEASE_S, MOST_LEASE_S = 5.0, 1e9  # the price, which renews a lease, comes once a second, and may be lost
_TERMS = {  # least, or 0, and most
    "min_rate_hz": (0.0, _MOST_RATE_HZ),
    "weight": (1e-6, 1e6),
    "wire_bytes": (1.0, 1e12),  # the largest sample there is, to a thousand readers
}
_MOST_PACKETS = 10**9
ROW_FIELDS = ("depth", "deadline_ns", "rate_hz", *_TERMS, "packets")  # of a row of a plan, in this order


def checked_row(topic: str, row: Any, own: WriterQos) -> TopicPlan:
    """Return the row of a plan message for a publisher whose application chose ``own``.

    Raises
    ------
    ValueError
        If a value is missing or out of bounds; the message names topic and field.
    """
    try:
        if not isinstance(row, list) or len(row) != len(ROW_FIELDS):
            raise ValueError(f"{str(row)[:80]!r} has not the numbers {', '.join(ROW_FIELDS)}")  # noqa: TRY301 - names the topic
        given = dict(zip(ROW_FIELDS, row, strict=True))
        deadline_ns = checked_deadline_ns(integer("deadline_ns", given["deadline_ns"]), own_ns=own.deadline_ns)
        rate_hz = math.inf if given["rate_hz"] is None else number("rate_hz", given["rate_hz"], most=_MOST_RATE_HZ)
        return TopicPlan(
            depth=integer("depth", given["depth"], least=1, most=max(MOST_DEPTH, own.depth)),
            deadline_ns=deadline_ns,
            rate_hz=rate_hz,
            packets=integer("packets", given["packets"], most=_MOST_PACKETS),
            **{name: _term(name, given[name], least, most) for name, (least, most) in _TERMS.items()},
        )
    except ValueError as fault:
        raise ValueError(f"{topic}: {fault}") from fault


def _term(name: str, value: Any, least: float, most: float) -> float:
    if 0 < (found := number(name, value, most=most)) < least:
        raise ValueError(f"{name} = {found} is below {least:g}")
    return found


def checked_depth(depth: int, *, most: int) -> int:
    """Return a KEEP_LAST depth, 1..``most`` (samples).

    Raises
    ------
    ValueError
        If it is out of bounds.
    """
    if not 1 <= depth <= most:
        raise ValueError(f"depth = {depth} is outside 1..{most}")
    return depth


def checked_deadline_ns(deadline_ns: int, *, own_ns: int) -> int:
    """Return a deadline period, 0 = infinite (ns).

    Parameters
    ----------
    own_ns : the application's own deadline, always allowed (ns)

    Raises
    ------
    ValueError
        If it is out of bounds.
    """
    if deadline_ns < 0:
        raise ValueError(f"deadline_ns = {deadline_ns} is negative; 0 means infinite")
    if 0 < deadline_ns < LEAST_DEADLINE_NS and deadline_ns != own_ns:
        raise ValueError(f"deadline_ns = {deadline_ns} is shorter than {LEAST_DEADLINE_NS} ns; 0 = infinite")
    return 0 if deadline_ns >= INFINITE_NS else deadline_ns
