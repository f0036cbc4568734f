"""What one topic asks of the link and of memory, in exact rationals: a row of the program (DESIGN §4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from arpd.model import Binding
from arpd.rounding import depth_cap, rational

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model import Topic

_NONE = Fraction(0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One topic's wishes, reconciled with each other and with the link.

    Parameters
    ----------
    topic : where the row comes from
    cost : a_i = k_i·t_ovh + s_i/C, link time per message; 0 = the topic does not use the link (s)
    floor : ℓ_i (Hz)
    ceiling : u_i; None = unbounded, possible only at cost 0 (Hz)
    window : τ_i = Dmax_i/Rmax_i = Dmax_i·a_i, capped by the latency budget (s)
    reserve : δ_i (samples)
    slot : m_i, memory per sample of history (bytes)
    """

    topic: Topic
    cost: Fraction
    floor: Fraction
    ceiling: Fraction | None
    window: Fraction
    reserve: Fraction
    slot: Fraction

    @property
    def max_rate_hz(self) -> float:
        """Rmax_i = 1/a_i, the rate with the link to itself (Hz)."""
        return float(1 / self.cost) if self.cost else math.inf

    def depth_cap(self, rate_hz: Fraction) -> Fraction:
        """Most history a rate justifies: min(Dmax_i, τ_i·R_i − δ_i), never below Dmin_i (samples)."""
        return depth_cap(
            rate_hz,
            window_s=self.window,
            reserve=self.reserve,
            min_depth=self.topic.min_depth,
            max_depth=self.topic.max_depth,
        )

    def depth_binding(self, rate_hz: Fraction) -> Binding:
        """Return what holds the depth at its cap; Eq. (3) ties history to the topic's part of the link."""
        justified = self.window * rate_hz - self.reserve
        if justified < self.topic.min_depth:
            return Binding.FLOOR
        if justified >= self.topic.max_depth:
            return Binding.MAX_DEPTH
        return Binding.LATENCY_BUDGET if self.window < self.topic.max_depth * self.cost else Binding.LINK


def row(topic: Topic, *, capacity: Fraction, packet_overhead: Fraction, depth_reserve: Fraction) -> Row:
    """Reconcile one topic's wishes.

    A desired rate of ``inf`` means no wish: Rmax_i, what the link carries of this topic alone. One of 0 means that
    nothing was measured yet: the floor. A floor above the desired rate is lowered to it, for a deadline shorter than
    the source's own period would be missed for ever.

    Parameters
    ----------
    capacity : C > 0 (bytes/s)
    packet_overhead : t_ovh (s)
    depth_reserve : δ_i as a multiple of Dmin_i
    """
    refuse_nonsense(topic)
    cost = topic.packets * packet_overhead + rational(topic.wire_bytes) / capacity
    floor = rational(topic.min_rate_hz)
    ceiling: Fraction | None = None
    if math.isfinite(topic.desired_rate_hz):
        ceiling = rational(topic.desired_rate_hz) or floor
        floor = min(floor, ceiling)
    if cost:
        ceiling = max(floor, 1 / cost if ceiling is None else min(ceiling, 1 / cost))
    window = topic.max_depth * cost
    if topic.latency_budget_s is not None:
        window = min(window, rational(topic.latency_budget_s))
    return Row(
        topic=topic,
        cost=cost,
        floor=floor,
        ceiling=ceiling,
        window=window,
        reserve=depth_reserve * topic.min_depth,
        slot=rational(topic.slot_bytes),
    )


def refuse_nonsense(topic: Topic) -> None:
    """Raise ``ValueError`` naming the topic and the field when a number is none the program can use."""
    finite = {
        "wire_bytes": topic.wire_bytes,
        "min_rate_hz": topic.min_rate_hz,
        "slot_bytes": topic.slot_bytes,
        "latency_budget_s": topic.latency_budget_s or 0.0,
    }
    for name, value in finite.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{topic.name}: {name} {value!r} must be a number of at least 0")
    if not topic.desired_rate_hz >= 0.0:  # also refuses nan
        raise ValueError(f"{topic.name}: desired_rate_hz {topic.desired_rate_hz!r} must be at least 0 or inf")
    if not (math.isfinite(topic.weight) and topic.weight > 0.0):
        raise ValueError(f"{topic.name}: weight {topic.weight!r} must be a number above 0")
    if not 1 <= topic.min_depth <= topic.max_depth:
        raise ValueError(f"{topic.name}: depths {topic.min_depth}..{topic.max_depth} must be a range from 1 up")


def give_up(
    amounts: Sequence[Fraction], weights: Sequence[float], deficit: Fraction
) -> tuple[list[Fraction], dict[float, Fraction]]:
    """Cut amounts by ``deficit``, the lightest weight class first and only as far as needed.

    Within a class every amount keeps the same part, so equal topics are cut equally.

    Returns
    -------
    kept : the part of each amount that is left, 0..1
    cuts : weight class → part left, only for the classes that lost something
    """
    cuts: dict[float, Fraction] = {}
    for weight in sorted(set(weights)):
        total = sum((a for a, w in zip(amounts, weights, strict=True) if w == weight), _NONE)
        cut = min(total, deficit)
        if cut > 0:
            cuts[weight] = 1 - cut / total
            deficit -= cut
    return [cuts.get(weight, Fraction(1)) for weight in weights], cuts
