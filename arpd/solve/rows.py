"""Rows of the program in whole numbers: what topics ask of the link and of memory.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING

from arpd.model.allocation import Binding, Topic
from arpd.model.plan import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Parts of a sample that count history. Rounding down to a part and then to a sample equals rounding down to a sample,
#: so no depth falls through binary noise, and every topic's history is a multiple of the same part.
SAMPLE = 1 << 64


@dataclass(frozen=True, kw_only=True, slots=True)
class Units:
    """Parts in which ``Row`` counts, chosen so every number is whole.

    Parameters
    ----------
    time : parts of a second of link time
    rate : parts of a hertz
    weight : parts of a weight of 1
    """

    time: int
    rate: int
    weight: int

    @property
    def share(self) -> int:
        """Parts of the link: e = a·R."""
        return self.time * self.rate


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """Preferences of one topic, reconciled with each other and with the link.

    Parameters
    ----------
    topic : source of the row
    units : units of the whole numbers
    weight : w_i (1/weight)
    cost : a_i = k_i·t_ovh + s_i/C = 1/Rmax_i, link time per message, > 0 (1/time s)
    lo, hi : a_i·ℓ_i and a_i·u_i, the shares at the floor and at the desired rate (1/share)
    ceiling : what stops a topic at ``hi``: its desired rate, or the link when that rate needs more than all of it
    window_s : τ_i = Dmax_i/Rmax_i = Dmax_i·a_i, capped by the latency budget: the time a full history stands for (s)
    window : what sets τ_i, the link or the latency budget
    """

    topic: Topic
    units: Units
    weight: int
    cost: int
    lo: int
    hi: int
    ceiling: Binding
    window_s: Ratio
    window: Binding

    @property
    def max_rate_hz(self) -> float:
        """Rmax_i = 1/a_i, the rate of a topic that has the link to itself (Hz)."""
        return self.units.time / self.cost

    def rate_hz(self, share: Ratio) -> Ratio:
        """Return R_i = e_i/a_i, the rate that a share e_i of the link carries, in 1/share (Hz)."""
        return share[0], share[1] * self.cost * self.units.rate

    @property
    def wish_hz(self) -> Ratio:
        """Desired rate u_i, also where this link cannot carry it now (Hz); Rmax_i without a wish."""
        if math.isinf(self.topic.desired_rate_hz):
            return self.rate_hz((self.hi, 1))
        return decimal(self.topic.desired_rate_hz or self.topic.min_rate_hz)

    def justified(self, rate_hz: Ratio, *, reserve: int) -> int:
        """Return τ_i·R_i − δ_i, the history that Eq. (3) and (G2) allow at a rate; δ_i = reserve·Dmin_i (1/SAMPLE)."""
        samples = self.window_s[0] * rate_hz[0] * SAMPLE // (self.window_s[1] * rate_hz[1])
        return samples - reserve * self.topic.min_depth * SAMPLE

    def depth_cap(self, justified: int) -> int:
        """Return the most history of the topic: what is justified, within Dmin_i..Dmax_i (1/SAMPLE).

        Where the floor and the reserve δ collide, δ shrinks by exactly as much as it must. So the cap is continuous and
        monotone in the rate; dropping δ at once would make a slower topic deeper.
        """
        return max(self.topic.min_depth * SAMPLE, min(self.topic.max_depth * SAMPLE, justified))

    def depth_binding(self, justified: int) -> Binding:
        """Return what stops the depth at its cap; Eq. (3) ties history to the topic's part of the link."""
        if justified < self.topic.min_depth * SAMPLE:
            return Binding.FLOOR
        return Binding.MAX_DEPTH if justified >= self.topic.max_depth * SAMPLE else self.window


def rows_of(topics: Sequence[Topic], *, capacity: Ratio, packet_overhead: Ratio, parts: int) -> list[Row]:
    """Reconcile the topics' preferences, and find units in which all of them are whole.

    Parameters
    ----------
    capacity : C > 0 (bytes/s)
    packet_overhead : t_ovh (s)
    parts : number that must divide a share of 1
    """
    for topic in topics:
        refuse_nonsense(topic)
    weights, weight_scale = whole([decimal(topic.weight) for topic in topics])
    sizes, size_scale = whole([decimal(topic.wire_bytes) for topic in topics])
    floors, floor_scale = whole([decimal(topic.min_rate_hz) for topic in topics])
    rates = [0.0 if math.isinf(topic.desired_rate_hz) else topic.desired_rate_hz for topic in topics]
    desired, desired_scale = whole([decimal(rate_hz) for rate_hz in rates])
    rate_scale = math.lcm(floor_scale, desired_scale)
    # a_i = k_i·t + s_i/C over the common denominator of t, of the sizes and of C
    units = Units(time=packet_overhead[1] * size_scale * capacity[0] * parts, rate=rate_scale, weight=weight_scale)
    per_packet = packet_overhead[0] * size_scale * capacity[0] * parts
    per_byte = packet_overhead[1] * capacity[1] * parts
    return [
        _row(
            topic,
            units,
            weight=weight,
            cost=topic.packets * per_packet + size * per_byte,
            floor=floor * (rate_scale // floor_scale),
            desired=rate * (rate_scale // desired_scale),
        )
        for topic, weight, size, floor, rate in zip(topics, weights, sizes, floors, desired, strict=True)
    ]


def _row(topic: Topic, units: Units, *, weight: int, cost: int, floor: int, desired: int) -> Row:
    """Reconcile the preferences of one topic.

    A desired rate of ``inf`` means Rmax_i, what the link carries of this topic alone. A desired rate of 0 means that
    nothing was measured yet, so the floor counts. A floor above the desired rate falls to it, because the source would
    miss every deadline shorter than its own period.
    """
    if math.isinf(topic.desired_rate_hz):
        lo, wanted = cost * floor, units.share
    else:
        ceiling = desired or floor
        lo, wanted = cost * min(floor, ceiling), cost * ceiling
    link = topic.max_depth * cost, units.time
    budget = link if topic.latency_budget_s is None else decimal(topic.latency_budget_s)
    is_link = link[0] * budget[1] <= budget[0] * link[1]
    return Row(
        topic=topic,
        units=units,
        weight=weight,
        cost=cost,
        lo=lo,
        hi=max(lo, min(wanted, units.share)),
        ceiling=Binding.DESIRED_RATE if wanted < units.share else Binding.LINK,
        window_s=link if is_link else budget,
        window=Binding.LINK if is_link else Binding.LATENCY_BUDGET,
    )


def refuse_nonsense(topic: Topic) -> None:
    """Raise ``ValueError`` with topic and field when the program cannot use a number."""
    finite = {
        "min_rate_hz": topic.min_rate_hz,
        "slot_bytes": topic.slot_bytes,
        "latency_budget_s": topic.latency_budget_s or 0.0,
    }
    for name, value in finite.items():
        if not 0.0 <= value < math.inf:
            raise ValueError(f"{topic.name}: {name} {value!r} must be a number of at least 0")
    if not topic.desired_rate_hz >= 0.0:  # also refuses nan
        raise ValueError(f"{topic.name}: desired_rate_hz {topic.desired_rate_hz!r} must be at least 0 or inf")
    for name, value in (("wire_bytes", topic.wire_bytes), ("weight", topic.weight)):
        if not 0.0 < value < math.inf:
            raise ValueError(f"{topic.name}: {name} {value!r} must be a number above 0")
    if not 1 <= topic.min_depth <= topic.max_depth:
        raise ValueError(f"{topic.name}: depths {topic.min_depth}..{topic.max_depth} must be a range from 1 up")


def give_up(amounts: Sequence[int], weights: Sequence[int], deficit: int) -> dict[int, Ratio]:
    """Cut amounts by ``deficit``, the lightest weight class first and only as far as needed.

    Within a class every amount keeps the same part, so equal topics are cut equally.

    Returns
    -------
    Weight class → its remaining part, 0..1, only for the classes that lose something.
    """
    left: dict[int, Ratio] = {}
    totals: dict[int, int] = {}
    for amount, weight in zip(amounts, weights, strict=True):
        totals[weight] = totals.get(weight, 0) + amount
    for weight, total in sorted(totals.items()):
        cut = min(total, deficit)
        if cut > 0:
            left[weight] = (total - cut, total)
            deficit -= cut
    return left


#: A numerator and a denominator > 0, not reduced: a ``Fraction`` spends most of its time on reducing them.
Ratio = tuple[int, int]
#: DDS counts whole seconds in 32 bits (DDS 1.4 §2.3.2, Duration_t); a slower topic counts as paused.
_LONGEST_PERIOD_NS = (2**31 - 1) * NANOSECONDS_PER_SECOND


@lru_cache(maxsize=8192)
def decimal(value: float) -> Ratio:
    """Return the decimal that a person reads in ``value``: 0.85 is 17/20, not the nearest binary fraction."""
    return Fraction(repr(float(value))).as_integer_ratio()


def rational(value: float) -> Fraction:
    """Return `decimal` as a ``Fraction``."""
    return Fraction(*decimal(value))


def whole(values: Sequence[Ratio]) -> tuple[list[int], int]:
    """Return the values as whole multiples of 1/scale, and that scale; sums and comparisons are exact and cheap."""
    scale = math.lcm(*(denominator for _, denominator in values))
    return [numerator * (scale // denominator) for numerator, denominator in values], scale


def period_ns(rate_hz: Ratio) -> int:
    """Return the shortest whole period that is not faster than the rate: ⌈1e9 / R⌉ (ns); 0 for a paused topic.

    Rounding the period up can only lower the rate, and every constraint on the link, Eq. (2) as well as (G1), loosens
    as R falls, so a feasible rate stays feasible. A period above the longest DDS duration is a pause, too.
    """
    numerator, denominator = rate_hz
    if numerator <= 0:
        return 0
    period = -(-NANOSECONDS_PER_SECOND * denominator // numerator)
    return period if period <= _LONGEST_PERIOD_NS else 0


def rate_of(period: int) -> Ratio:
    """Return the rate of a whole period in ns (Hz); 0 for a paused topic."""
    return (NANOSECONDS_PER_SECOND, period) if period else (0, 1)
