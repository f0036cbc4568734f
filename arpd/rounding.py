"""Exact rounding: from a real optimum to the integer nanoseconds and samples a publisher runs with (DESIGN §4)."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

from arpd.model import NANOSECONDS_PER_SECOND

#: A value this close to an integer (relative) is that integer seen through binary noise: 8.9999999999 is 9.
SNAP = Fraction(1, 10**9)
#: Unit of the integer upper bound in ``surplus``; fine enough that only an exact tie is inconclusive.
_UNITS = 1 << 128


@lru_cache(maxsize=4096)
def rational(value: float) -> Fraction:
    """Return the decimal a person would read in ``value``: 0.85 is 17/20, not the nearest binary fraction."""
    return Fraction(repr(float(value)))


def snap(value: Fraction) -> Fraction:
    """Return the nearest positive integer if ``value`` is it up to float noise, else ``value`` unchanged."""
    nearest = round(value)
    return Fraction(nearest) if nearest > 0 and abs(value - nearest) <= SNAP * nearest else value


def period_ns(rate_hz: Fraction) -> int:
    """Shortest whole period that is not faster than the rate: ⌈1e9 / R⌉ (ns); 0 for a paused topic.

    Rounding the period up can only lower the rate, and both link constraints, Eq. (2) and (G1), loosen as R falls.
    """
    return math.ceil(NANOSECONDS_PER_SECOND / rate_hz) if rate_hz > 0 else 0


def rate_of(period: int) -> Fraction:
    """Rate Rq of a whole period in ns (Hz); 0 for a paused topic."""
    return Fraction(NANOSECONDS_PER_SECOND, period) if period else Fraction(0)


def depth_cap(rate_hz: Fraction, *, window_s: Fraction, reserve: Fraction, min_depth: int, max_depth: int) -> Fraction:
    """Most history a rate justifies: min(Dmax, τ·R − δ), Eq. (3) and (G2), but never below ``min_depth`` (samples).

    Where the floor and the reserve δ collide, δ gives way by exactly as much as it must. That keeps the cap
    continuous and monotone in the rate; dropping δ at once would make a slower topic deeper.
    """
    return max(Fraction(min_depth), min(Fraction(max_depth), window_s * rate_hz - reserve))


def stretch(periods: list[int], *, costs: list[Fraction], budget: Fraction, preferred: list[bool]) -> list[int]:
    """Lengthen one period until Σ a_i·1e9/period_i ≤ B holds in exact arithmetic.

    The periods come from floats, so they may miss the budget by their noise: a few parts in 1e9, which one topic
    gives back by a few nanoseconds. Every step strictly lowers the sum, so this ends.

    Parameters
    ----------
    periods : whole periods, 0 = paused (ns)
    costs : a_i, link time per message (s)
    budget : B, the share of link time to keep (dimensionless)
    preferred : topics the link already holds back; they give way before one that runs at the rate it wants
    """
    periods = list(periods)
    while (excess := surplus(periods, costs=costs, budget=budget)) > 0:
        index = max(
            (i for i, period in enumerate(periods) if period and costs[i]),
            key=lambda i: (preferred[i], costs[i] / periods[i] ** 2),
        )
        share = costs[index] * rate_of(periods[index])
        if share <= excess:  # noise never gets here; halving keeps the loop finite for any caller
            periods[index] *= 2
        else:
            wanted = math.ceil(costs[index] * NANOSECONDS_PER_SECOND / (share - excess))
            periods[index] = max(periods[index] + 1, wanted)
    return periods


def surplus(periods: list[int], *, costs: list[Fraction], budget: Fraction) -> Fraction:
    """How far Σ a_i·1e9/period_i is above B, in exact arithmetic; 0 when it is not.

    The sum of fractions with n unrelated denominators grows to thousands of digits, so an integer upper bound
    decides first (each term rounded up to 2⁻¹²⁸); the exact sum is made only when that bound does not settle it.
    """
    bound = sum(
        -(-cost.numerator * NANOSECONDS_PER_SECOND * _UNITS // (cost.denominator * period))
        for cost, period in zip(costs, periods, strict=True)
        if period
    )
    if bound * budget.denominator <= budget.numerator * _UNITS:
        return Fraction(0)
    exact = sum((c * rate_of(p) for c, p in zip(costs, periods, strict=True)), Fraction(0))
    return max(Fraction(0), exact - budget)


def shorten(depths: list[int], *, slots: list[Fraction], budget: Fraction, preferred: list[bool]) -> list[int]:
    """Drop single samples until Σ m_i·D_i ≤ M holds in exact arithmetic or every history is down to one.

    Floors of floats exceed the budget only where a depth was snapped up to a whole sample that does not quite fit.

    Parameters
    ----------
    depths : whole depths ≥ 1 (samples)
    slots : m_i (bytes)
    budget : M (bytes)
    preferred : topics memory already holds back; they give way first
    """
    depths = list(depths)
    excess = sum((slot * depth for slot, depth in zip(slots, depths, strict=True)), Fraction(0)) - budget
    while excess > 0 and max(depths) > 1:
        index = max(
            (i for i, depth in enumerate(depths) if depth > 1), key=lambda i: (preferred[i], slots[i] * depths[i])
        )
        depths[index] -= 1
        excess -= slots[index]
    return depths
