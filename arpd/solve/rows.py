"""What the topics ask of the link and of memory, in whole numbers: the rows of the program.

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

#: Parts of a sample in which history is counted. Rounding down to a part first and to a sample later is rounding down
#: to a sample, so no depth falls through binary noise; and every topic's history is a multiple of the same part.
SAMPLE = 1 << 64


@dataclass(frozen=True, kw_only=True, slots=True)
class Units:
    """The parts in which ``Row`` counts, chosen so that everything is whole.

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
    """One topic's wishes, reconciled with each other and with the link.

    Parameters
    ----------
    topic : where the row comes from
    units : what the whole numbers count
    weight : w_i (1/weight)
    cost : a_i = k_i·t_ovh + s_i/C = 1/Rmax_i, link time per message, > 0 (1/time s)
    lo, hi : a_i·ℓ_i and a_i·u_i, the shares at the floor and at the desired rate (1/share)
    ceiling : what a topic at ``hi`` lacks for more: a wish, or the link, when the wish was for more than all of it
    window_s : τ_i = Dmax_i/Rmax_i = Dmax_i·a_i, capped by the latency budget: what a full history stands for (s)
    window : whether the link or the latency budget sets τ_i
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
        """Rmax_i = 1/a_i, the rate with the link to itself (Hz)."""
        return self.units.time / self.cost

    def rate_hz(self, share: Ratio) -> Ratio:
        """R_i = e_i/a_i, the rate that a share of the link carries (Hz).

        Parameters
        ----------
        share : e_i (1/share)
        """
        return share[0], share[1] * self.cost * self.units.rate

    def justified(self, rate_hz: Ratio, *, reserve: int) -> int:
        """Return τ_i·R_i − δ_i, the history that Eq. (3) and (G2) allow at a rate (1/SAMPLE).

        Parameters
        ----------
        reserve : δ_i as a multiple of Dmin_i
        """
        samples = self.window_s[0] * rate_hz[0] * SAMPLE // (self.window_s[1] * rate_hz[1])
        return samples - reserve * self.topic.min_depth * SAMPLE

    def depth_cap(self, justified: int) -> int:
        """Most history the topic may have: what is justified, within Dmin_i..Dmax_i (1/SAMPLE).

        Where the floor and the reserve δ collide, δ gives way by exactly as much as it must. That keeps the cap
        continuous and monotone in the rate; dropping δ at once would make a slower topic deeper.
        """
        return max(self.topic.min_depth * SAMPLE, min(self.topic.max_depth * SAMPLE, justified))

    def depth_binding(self, justified: int) -> Binding:
        """Return what holds the depth at its cap; Eq. (3) ties history to the topic's part of the link."""
        if justified < self.topic.min_depth * SAMPLE:
            return Binding.FLOOR
        return Binding.MAX_DEPTH if justified >= self.topic.max_depth * SAMPLE else self.window


def rows_of(topics: Sequence[Topic], *, capacity: Ratio, packet_overhead: Ratio, parts: int) -> list[Row]:
    """Reconcile the topics' wishes, and find units in which all of them are whole.

    Parameters
    ----------
    capacity : C > 0 (bytes/s)
    packet_overhead : t_ovh (s)
    parts : a number by which a share of 1 must be divisible
    """
    for topic in topics:
        refuse_nonsense(topic)
    weights, weight_scale = whole([decimal(topic.weight) for topic in topics])
    sizes, size_scale = whole([decimal(topic.wire_bytes) for topic in topics])
    floors, floor_scale = whole([decimal(topic.min_rate_hz) for topic in topics])
    wishes, wish_scale = whole([decimal(_finite(topic.desired_rate_hz)) for topic in topics])
    rate_scale = math.lcm(floor_scale, wish_scale)
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
            wish=wish * (rate_scale // wish_scale),
        )
        for topic, weight, size, floor, wish in zip(topics, weights, sizes, floors, wishes, strict=True)
    ]


def _row(topic: Topic, units: Units, *, weight: int, cost: int, floor: int, wish: int) -> Row:
    """Reconcile one topic's wishes.

    A desired rate of ``inf`` means no wish: Rmax_i, what the link carries of this topic alone. One of 0 means that
    nothing was measured yet: the floor. A floor above the desired rate is lowered to it, for a deadline shorter than
    the source's own period would be missed for ever.
    """
    if math.isinf(topic.desired_rate_hz):
        lo, wanted = cost * floor, units.share
    else:
        ceiling = wish or floor
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


def _finite(rate_hz: float) -> float:
    return 0.0 if math.isinf(rate_hz) else rate_hz


def refuse_nonsense(topic: Topic) -> None:
    """Raise ``ValueError`` naming the topic and the field when a number is none the program can use."""
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
    Weight class → the part of it that is left, 0..1, only for the classes that lose something.
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
