"""Bounds of what a plan may ask of a node, and a user of a publisher; pure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from arpd.adapters.ros.names import INFINITE_NS
from arpd.model.plan import MOST_GENERATION, TopicPlan

if TYPE_CHECKING:
    from collections.abc import Mapping

    from arpd.model.endpoints import WriterQos

MOST_DEPTH = 5000
# No topic that crosses a link is faster than 100 kHz. The timer of a deadline much shorter than the source's period
# takes a tenth of a core (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
MOST_RATE_HZ = 1e6
LEAST_LEASE_S, MOST_LEASE_S = 5.0, 1e9  # the price, which renews a lease, comes once a second, and may be lost
_TERMS = {  # least and most, or 0; and a rate may be infinite
    "rate_hz": (0.0, MOST_RATE_HZ),
    "min_rate_hz": (0.0, MOST_RATE_HZ),
    "weight": (1e-6, 1e6),
    "wire_bytes": (1.0, 1e12),  # the largest sample there is, to a thousand readers
    "packets": (0, 10**9),
}


def checked_row(topic: str, row: Mapping[str, Any], own: WriterQos) -> TopicPlan:
    """Return the row of a plan message for a publisher whose application chose ``own``.

    Raises
    ------
    ValueError
        If a value is out of bounds; the message names topic and field.
    """
    try:
        depth = checked_depth(row["depth"], most=max(MOST_DEPTH, own.depth))
        deadline_ns = checked_deadline_ns(row["deadline_ns"], own_ns=own.deadline_ns)
        for field, (least, most) in _TERMS.items():
            _check(field, row[field], least, most)
    except ValueError as fault:
        raise ValueError(f"{topic}: {fault}") from fault
    return TopicPlan(**{**row, "depth": depth, "deadline_ns": deadline_ns})


def _check(field: str, value: float, least: float, most: float) -> None:
    is_unpaced = field == "rate_hz" and value == math.inf
    if not (value == 0 or is_unpaced or least <= value <= most):
        raise ValueError(f"{field} = {value} is outside {least:g}..{most:g}")


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


def check_grant(*, generation: int, lease_s: float, in_force: int) -> None:
    """Refuse a plan that is older than the one in force, or whose lease is out of bounds.

    Parameters
    ----------
    lease_s : time for which the plan outlives its daemon, 0 = without end (s)
    in_force : generation of the plan in force

    Raises
    ------
    ValueError
        If it is refused.
    """
    if generation < in_force:
        raise ValueError(f"generation {generation} is older than {in_force}, the plan in force")
    if generation > MOST_GENERATION:
        raise ValueError(f"generation {generation} is more than {MOST_GENERATION}")
    if lease_s != 0 and not LEAST_LEASE_S <= lease_s <= MOST_LEASE_S:
        raise ValueError(f"lease_s = {lease_s} is outside {LEAST_LEASE_S:g}..{MOST_LEASE_S:g}; 0 = never ends")
