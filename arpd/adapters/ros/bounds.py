"""Bounds of the QoS parameters of writers and readers.

Each function returns a valid value, or raises ValueError with a message that names the parameter. rclpy has already
refused values of another type.
"""

from __future__ import annotations

import math
from typing import Any

from arpd.adapters.ros.names import INFINITE_NS

MOST_DEPTH = 5000
# No topic that crosses a link is faster than 100 kHz. The timer of a deadline much shorter than the source's period
# takes a tenth of a core (measured from 1 ms down, Fast DDS).
LEAST_DEADLINE_NS = 10_000
MOST_RATE_HZ = 1e6
LEAST_WEIGHT, MOST_WEIGHT = 1e-6, 1e6
MOST_WIRE_BYTES = 1e12  # the largest sample there is, to a thousand readers
MOST_PACKETS = 10**9
LEAST_LEASE_S, MOST_LEASE_S = 5.0, 1e9  # the price, which renews a lease, comes once a second, and may be lost


def checked_depth(parameter: Any, most: int) -> int:
    """Return a KEEP_LAST depth, 1..``most`` (samples)."""
    if not 1 <= parameter.value <= most:
        raise ValueError(f"{parameter.name} = {parameter.value} is outside 1..{most}")
    return int(parameter.value)


def checked_deadline_ns(parameter: Any, *, own_ns: int = 0) -> int:
    """Return a deadline period, 0 = infinite (ns).

    Parameters
    ----------
    own_ns : the application's own deadline, always allowed (ns)
    """
    if parameter.value < 0:
        raise ValueError(f"{parameter.name} = {parameter.value} is negative; 0 means infinite")
    if 0 < parameter.value < LEAST_DEADLINE_NS and parameter.value != own_ns:
        raise ValueError(f"{parameter.name} = {parameter.value} is shorter than {LEAST_DEADLINE_NS} ns; 0 = infinite")
    return 0 if parameter.value >= INFINITE_NS else int(parameter.value)


def checked_rate_hz(parameter: Any) -> float:
    """Return a paced rate, 0 = paused, .inf = unpaced (Hz)."""
    if not (0 <= parameter.value <= MOST_RATE_HZ or parameter.value == math.inf):
        raise ValueError(
            f"{parameter.name} = {parameter.value} is not a rate; use 0 to {MOST_RATE_HZ:g} Hz, 0 = paused, "
            ".inf = unpaced"
        )
    return float(parameter.value)


def checked_floor_hz(parameter: Any) -> float:
    """Return a floor of the rate (Hz)."""
    if not 0 <= parameter.value <= MOST_RATE_HZ:
        raise ValueError(f"{parameter.name} = {parameter.value} is not a floor; use 0 to {MOST_RATE_HZ:g} Hz")
    return float(parameter.value)


def checked_weight(parameter: Any) -> float:
    """Return a weight, 0 = the price does not apply."""
    if parameter.value != 0 and not LEAST_WEIGHT <= parameter.value <= MOST_WEIGHT:
        raise ValueError(
            f"{parameter.name} = {parameter.value} is not a weight; use {LEAST_WEIGHT:g} to {MOST_WEIGHT:g}, "
            "0 = the price does not apply"
        )
    return float(parameter.value)


def checked_wire_bytes(parameter: Any) -> float:
    """Return the bytes of a sample on the link, 0 = unknown (bytes)."""
    if parameter.value != 0 and not 1.0 <= parameter.value <= MOST_WIRE_BYTES:
        raise ValueError(
            f"{parameter.name} = {parameter.value} is not a size; use 1 to {MOST_WIRE_BYTES:g} bytes, 0 = unknown"
        )
    return float(parameter.value)


def checked_packets(parameter: Any) -> int:
    """Return the packets of a sample on the link."""
    if not 0 <= parameter.value <= MOST_PACKETS:
        raise ValueError(f"{parameter.name} = {parameter.value} is outside 0..{MOST_PACKETS}")
    return int(parameter.value)


def checked_lease_s(parameter: Any) -> float:
    """Return the time for which a plan outlives its daemon, 0 = without end (s)."""
    if parameter.value != 0 and not LEAST_LEASE_S <= parameter.value <= MOST_LEASE_S:
        raise ValueError(
            f"{parameter.name} = {parameter.value} is not a lease; use {LEAST_LEASE_S:g} to {MOST_LEASE_S:g} s, "
            "0 = never ends"
        )
    return float(parameter.value)
