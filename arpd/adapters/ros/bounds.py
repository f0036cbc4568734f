"""What a QoS parameter may be, for writers and readers alike."""

from __future__ import annotations

import math
from typing import Any

from arpd.adapters.ros.names import INFINITE_NS

MOST_DEPTH = 5000
# Nothing that crosses a link is published faster than 100 kHz. A deadline much shorter than the period of its source
# costs a tenth of a core for its timer (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
MOST_RATE_HZ = 1e6
LEAST_LEASE_S, MOST_LEASE_S = 1.0, 1e9  # the gate, which keeps a lease alive, is repeated ten times a second


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


def checked_deadline_ns(parameter: Any, *, own_ns: int = 0) -> int:
    """Return a deadline period, 0 = infinite (ns).

    Parameters
    ----------
    own_ns : what the application chose itself, and may have again, however short (ns)

    Raises
    ------
    ValueError
        If it is negative, or so short that nothing keeps it; the message names the parameter.
    """
    if parameter.value < 0:
        raise ValueError(f"{parameter.name} = {parameter.value} is negative; 0 means infinite")
    if 0 < parameter.value < LEAST_DEADLINE_NS and parameter.value != own_ns:
        raise ValueError(f"{parameter.name} = {parameter.value} is shorter than {LEAST_DEADLINE_NS} ns; 0 = infinite")
    return 0 if parameter.value >= INFINITE_NS else int(parameter.value)


def checked_rate_hz(parameter: Any) -> float:
    """Return a paced rate, 0 = paused, .inf = unpaced (Hz).

    Raises
    ------
    ValueError
        If it is no such rate; the message names the parameter.
    """
    if not (0 <= parameter.value <= MOST_RATE_HZ or parameter.value == math.inf):
        raise ValueError(
            f"{parameter.name} = {parameter.value} is not a rate; use 0 to {MOST_RATE_HZ:g} Hz, 0 = paused, "
            ".inf = unpaced"
        )
    return float(parameter.value)


def checked_floor_hz(parameter: Any) -> float:
    """Return the rate below which the gate does not push (Hz).

    Raises
    ------
    ValueError
        If it is no such rate; the message names the parameter.
    """
    if not 0 <= parameter.value <= MOST_RATE_HZ:
        raise ValueError(f"{parameter.name} = {parameter.value} is not a floor; use 0 to {MOST_RATE_HZ:g} Hz")
    return float(parameter.value)


def checked_lease_s(parameter: Any) -> float:
    """Return how long a plan outlives its daemon, 0 = for good (s).

    Raises
    ------
    ValueError
        If it is no such time; the message names the parameter.
    """
    if parameter.value != 0 and not LEAST_LEASE_S <= parameter.value <= MOST_LEASE_S:
        raise ValueError(
            f"{parameter.name} = {parameter.value} is no time; use {LEAST_LEASE_S:g} to {MOST_LEASE_S:g} s, 0 = never"
        )
    return float(parameter.value)
