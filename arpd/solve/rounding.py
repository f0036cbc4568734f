"""Exact numbers: from the decimals people write and meters print to whole nanoseconds and samples (DESIGN §4)."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING

from arpd.model.values import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Sequence

#: A numerator and a denominator > 0, in whatever terms: a ``Fraction`` spends most of its time on the lowest ones.
Ratio = tuple[int, int]

#: DDS counts whole seconds in 32 bits (DDS 1.4 §2.3.2, Duration_t); what publishes less often does not publish.
_LONGEST_PERIOD_NS = (2**31 - 1) * NANOSECONDS_PER_SECOND


@lru_cache(maxsize=8192)
def decimal(value: float) -> Ratio:
    """Return the decimal a person would read in ``value``: 0.85 is 17/20, not the nearest binary fraction."""
    return Fraction(repr(float(value))).as_integer_ratio()


def rational(value: float) -> Fraction:
    """Return the same as a ``Fraction``."""
    return Fraction(*decimal(value))


def whole(values: Sequence[Ratio]) -> tuple[list[int], int]:
    """Return the values as whole multiples of 1/scale, and that scale: sums and comparisons are exact, and cheap."""
    scale = math.lcm(*(denominator for _, denominator in values))
    return [numerator * (scale // denominator) for numerator, denominator in values], scale


def period_ns(rate_hz: Ratio) -> int:
    """Shortest whole period that is not faster than the rate: ⌈1e9 / R⌉ (ns); 0 for a paused topic.

    Rounding the period up can only lower the rate, and every constraint on the link, Eq. (2) as well as (G1), loosens
    as R falls: what was feasible stays so. A period longer than a DDS duration can be is a pause, too.
    """
    numerator, denominator = rate_hz
    if numerator <= 0:
        return 0
    period = -(-NANOSECONDS_PER_SECOND * denominator // numerator)
    return period if period <= _LONGEST_PERIOD_NS else 0


def rate_of(period: int) -> Ratio:
    """Rate Rq of a whole period in ns (Hz); 0 for a paused topic."""
    return (NANOSECONDS_PER_SECOND, period) if period else (0, 1)
