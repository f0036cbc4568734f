"""What a QoS parameter may be, for writers and readers alike."""

from __future__ import annotations

import math
from typing import Any

from arpd.ros.names import INFINITE_NS

MOST_DEPTH = 5000


def checked_depth(parameter: Any, most: int) -> int:
    """Return a KEEP_LAST depth (samples); of the declared type, for rclpy refuses any other before it asks.

    Raises
    ------
    ValueError
        If it is outside 1..``most``; the message names the parameter.
    """
    if not 1 <= parameter.value <= most:
        raise ValueError(f"{parameter.name} = {parameter.value} is outside 1..{most}")
    return int(parameter.value)


def checked_deadline_ns(parameter: Any) -> int:
    """Return a deadline period, 0 = infinite (ns).

    Raises
    ------
    ValueError
        If it is negative; the message names the parameter.
    """
    if parameter.value < 0:
        raise ValueError(f"{parameter.name} = {parameter.value} is negative; 0 means infinite")
    return 0 if parameter.value >= INFINITE_NS else int(parameter.value)


def checked_lease_s(parameter: Any) -> float:
    """Return how long a plan outlives its daemon, 0 = for good (s).

    Raises
    ------
    ValueError
        If it is no such time; the message names the parameter.
    """
    if not 0 <= parameter.value < math.inf:
        raise ValueError(f"{parameter.name} = {parameter.value} is no time; use seconds ≥ 0, 0 = never")
    return float(parameter.value)
