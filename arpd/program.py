"""The DEPTH/DEADLINE program, topic by topic: (G1) divides the link, (G2) divides the memory (DESIGN §4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from arpd.demand import Row, give_up, refuse_nonsense, row
from arpd.model import Allocation, AllocationStatus, Binding, TopicAllocation
from arpd.rounding import period_ns, rate_of, rational, shorten, snap, stretch
from arpd.settings import Backend
from arpd.solvers import CheckedSolver, ShareProblem, load

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from arpd.model import Topic
    from arpd.settings import ProgramSettings

_NONE = Fraction(0)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Division:
    """How one budget was divided.

    Parameters
    ----------
    values : rate (Hz) or depth (samples) per row
    bindings : what stopped each value
    budget : what the division must keep: B (dimensionless) or M (bytes)
    backend : back end that answered
    given_up : what was given up, in words
    """

    values: list[Fraction]
    bindings: list[Binding]
    budget: Fraction
    backend: Backend
    given_up: tuple[str, ...] = ()


class Program:
    """Solves (G1), then (G2) on its result, and rounds to what publishers can run.

    (G1) divides link time: e_i = a_i·R_i = clip(ν·w_i, a_i·ℓ_i, a_i·u_i) with Σ e_i ≤ B = η − Σ a_i·ρ_i.
    (G2) divides memory: g_i = m_i·D_i/M, Σ g_i ≤ 1, Dmin_i ≤ D_i ≤ min(Dmax_i, τ_i·R_i − δ_i).

    With identical topics, η = 1, ρ = Rmin, no latency budget and ample memory this is Eq. (4) of the paper.

    Infeasibility is decided in exact arithmetic before any solver runs, and the answer gives way in this order, by no
    more than it must, so that no rate rises while the capacity falls:

    1. δ: where τ_i·R_i − δ_i would be below Dmin_i, the depth is Dmin_i. Every slow topic on a fast link meets
       this, and nobody loses anything by it: it shows as ``depth_binding`` FLOOR and is not called degraded.
    2. ρ, the rate reserve.
    3. the floors ℓ_i, class by class in ascending weight, down to 0 (paused); for memory, Dmin_i down to 1.

    Σ e_i never exceeds η, and the applied periods keep that in exact arithmetic.

    Parameters
    ----------
    settings : the operator's choice of back end
    headroom : η, the share of the capacity that may be planned, 0..1
    packet_overhead_s : t_ovh, link time per packet beyond its bytes (s)
    backend : back end for this program alone; None = the one in ``settings``
    rate_reserve : ρ_i as a multiple of ℓ_i; the paper's is 1, the daemon's 0 because η reserves already
    depth_reserve : δ_i as a multiple of Dmin_i; the paper's is 1
    clock : monotonic clock that times a solve (s); without one ``Allocation.solve_s`` stays 0
    """

    def __init__(
        self,
        *,
        settings: ProgramSettings,
        headroom: float,
        packet_overhead_s: float = 0.0,
        backend: Backend | None = None,
        rate_reserve: float = 0.0,
        depth_reserve: float = 1.0,
        clock: Callable[[], float] = lambda: 0.0,
    ) -> None:
        if not 0.0 < headroom <= 1.0:
            raise ValueError(f"headroom {headroom!r} must be above 0 and at most 1")
        for name, value in (
            ("packet_overhead_s", packet_overhead_s),
            ("rate_reserve", rate_reserve),
            ("depth_reserve", depth_reserve),
        ):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} {value!r} must be a number of at least 0")
        self._headroom = rational(headroom)
        self._packet_overhead = rational(packet_overhead_s)
        self._rate_reserve = rational(rate_reserve)
        self._depth_reserve = rational(depth_reserve)
        self._solver = CheckedSolver(load(backend or settings.backend))
        self._clock = clock
        self._last: tuple[tuple[float, tuple[Topic, ...], float], Allocation] | None = None

    @property
    def outcomes(self) -> Mapping[tuple[str, str], int]:
        """Copy of the counts (back end, ``solved`` | ``infeasible`` | ``failed``) since this program was made."""
        return self._solver.outcomes

    @property
    def disagreements(self) -> int:
        """Answers that ``exact`` contradicted since this program was made."""
        return self._solver.disagreements

    def solve(
        self, capacity_bytes_per_second: float, topics: Sequence[Topic], memory_budget_bytes: float
    ) -> Allocation:
        """Divide the link and the memory among ``topics``.

        ``deadline_ns`` of the answer is the bare period ⌈1e9/R⌉, 0 for a paused topic; the planner multiplies the
        slack in. A topic that cannot be given any rate is paused: rate 0, ``deadline_ns`` 0, depth at its floor.

        Parameters
        ----------
        capacity_bytes_per_second : C, after foreign traffic and before headroom, ≥ 0 (bytes/s)
        topics : the demand, one row each
        memory_budget_bytes : M, what all histories together may take, ≥ 0 (bytes)
        """
        question = (capacity_bytes_per_second, tuple(topics), memory_budget_bytes)
        if self._last is not None and self._last[0] == question:
            return self._last[1]  # most ticks bring nothing new, and exact arithmetic is most of a tick's cost
        started = self._clock()
        for name, value in (("capacity", capacity_bytes_per_second), ("memory budget", memory_budget_bytes)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} {value!r} must be a number of bytes of at least 0")
        allocation = self._allocate(rational(capacity_bytes_per_second), topics, rational(memory_budget_bytes))
        allocation = replace(allocation, solve_s=self._clock() - started)
        self._last = (question, allocation)
        return allocation

    def _allocate(self, capacity: Fraction, topics: Sequence[Topic], memory_budget: Fraction) -> Allocation:
        level = float(self._headroom * capacity)
        if not topics:
            return _empty(level)
        if not capacity:
            self._solver.note_infeasible()
            return _paused(topics)
        rows = [
            row(
                topic,
                capacity=capacity,
                packet_overhead=self._packet_overhead,
                depth_reserve=self._depth_reserve,
            )
            for topic in topics
        ]
        link = self._divide_link(rows)
        memory = self._divide_memory(rows, link.values, memory_budget)
        return _published(rows, link, memory, level)

    def _divide_link(self, rows: list[Row]) -> _Division:
        """(G1): a rate per row."""
        floors = [r.cost * r.floor for r in rows]
        needed = sum(floors, _NONE)
        reserve = self._rate_reserve * needed
        if needed + reserve <= self._headroom:
            return self._fill_link(rows, self._headroom - reserve)
        self._solver.note_infeasible()
        return _cut_rates(rows, floors, budget=self._headroom, reserve=reserve)

    def _fill_link(self, rows: list[Row], budget: Fraction) -> _Division:
        problem = ShareProblem(
            weights=_weights(rows),
            lo=tuple(float(r.cost * r.floor) for r in rows),
            hi=tuple(float(r.cost * r.ceiling) if r.ceiling is not None else 0.0 for r in rows),
            budget=float(budget),
        )
        shares, backend = self._solver.solve(problem)
        values, bindings = [], []
        for r, share, lo, hi in zip(rows, shares, problem.lo, problem.hi, strict=True):
            if r.ceiling is None:  # neither the link nor a wish holds it back; published as unpaced
                values.append(_NONE)
                bindings.append(Binding.NOTHING)
            elif share >= hi:
                values.append(r.ceiling)
                bindings.append(Binding.LINK if r.cost * r.ceiling >= 1 else Binding.DESIRED_RATE)
            elif share <= lo:
                values.append(r.floor)
                bindings.append(Binding.FLOOR if r.floor else Binding.LINK)
            else:
                values.append(snap(Fraction(share) / r.cost))
                bindings.append(Binding.LINK)
        return _Division(values=values, bindings=bindings, budget=budget, backend=backend)

    def _divide_memory(self, rows: list[Row], rates: list[Fraction], budget: Fraction) -> _Division:
        """(G2): a depth per row, given the rates."""
        needed = sum((r.slot * r.topic.min_depth for r in rows), _NONE)
        if needed > budget:
            self._solver.note_infeasible()
            return _cut_depths(rows, needed=needed, budget=budget)
        caps = [r.depth_cap(rate) for r, rate in zip(rows, rates, strict=True)]
        held = [r.depth_binding(rate) for r, rate in zip(rows, rates, strict=True)]
        if not budget:  # and thus no history takes memory: nothing to divide
            return _Division(values=caps, bindings=held, budget=budget, backend=self._solver.name)
        problem = ShareProblem(
            weights=_weights(rows),
            lo=tuple(float(r.slot * r.topic.min_depth / budget) for r in rows),
            # a bound above 1, the whole memory, would bind nothing and only scale badly
            hi=tuple(min(1.0, float(r.slot * cap / budget)) for r, cap in zip(rows, caps, strict=True)),
            budget=1.0,
        )
        shares, backend = self._solver.solve(problem)
        values, bindings = [], []
        for i, (r, share) in enumerate(zip(rows, shares, strict=True)):
            if share >= problem.hi[i] and r.slot * caps[i] <= budget:
                values.append(caps[i])
                bindings.append(held[i])
            elif share <= problem.lo[i]:
                values.append(Fraction(r.topic.min_depth))
                bindings.append(Binding.FLOOR)
            else:
                values.append(snap(Fraction(share) * budget / r.slot))
                bindings.append(Binding.MEMORY)
        return _Division(values=values, bindings=bindings, budget=budget, backend=backend)


def _cut_rates(rows: list[Row], floors: list[Fraction], *, budget: Fraction, reserve: Fraction) -> _Division:
    """Give up the rate reserve, then floors; what is left of the floors is all the link carries."""
    deficit = sum(floors, _NONE) - budget
    kept, cuts = give_up(floors, _weights(rows), deficit)
    left = max(_NONE, -deficit)
    notes = [f"rate reserve {_left(left / reserve)}"] if reserve else []
    notes += [f"rate floor of weight {weight:g} {_left(part)}" for weight, part in cuts.items()]
    values, bindings = [], []
    for r, part in zip(rows, kept, strict=True):
        if not r.cost:  # costs the link nothing, so it has nothing to give up
            values.append(r.ceiling or _NONE)
            bindings.append(Binding.NOTHING if r.ceiling is None else Binding.DESIRED_RATE)
        else:
            values.append(r.floor * part)
            held = Binding.DESIRED_RATE if r.floor == r.ceiling else Binding.FLOOR
            bindings.append(held if part == 1 and r.floor else Binding.LINK)
    return _Division(values=values, bindings=bindings, budget=budget, backend=Backend.EXACT, given_up=tuple(notes))


def _cut_depths(rows: list[Row], *, needed: Fraction, budget: Fraction) -> _Division:
    """Give up depth floors down to one sample, which is the least a history can hold."""
    spare = [r.slot * (r.topic.min_depth - 1) for r in rows]
    kept, cuts = give_up(spare, _weights(rows), needed - budget)
    notes = [f"depth floor of weight {weight:g} {_left(part)}" for weight, part in cuts.items()]
    if sum((r.slot for r in rows), _NONE) > budget:
        notes.append("memory budget below one sample per topic")
    return _Division(
        values=[1 + (r.topic.min_depth - 1) * part for r, part in zip(rows, kept, strict=True)],
        bindings=[Binding.FLOOR if part == 1 else Binding.MEMORY for part in kept],
        budget=budget,
        backend=Backend.EXACT,
        given_up=tuple(notes),
    )


def _published(rows: list[Row], link: _Division, memory: _Division, level: float) -> Allocation:
    """Round both divisions, so that they stay feasible, and put them into one answer."""
    periods = stretch(
        [period_ns(rate) for rate in link.values],
        costs=[r.cost for r in rows],
        budget=link.budget,
        preferred=[binding is Binding.LINK for binding in link.bindings],
    )
    depths = shorten(
        [
            math.floor(min(depth, r.depth_cap(rate_of(period))))
            for r, depth, period in zip(rows, memory.values, periods, strict=True)
        ],
        slots=[r.slot for r in rows],
        budget=memory.budget,
        preferred=[binding is Binding.MEMORY for binding in memory.bindings],
    )
    given_up = "; ".join(link.given_up + memory.given_up)
    return Allocation(
        topics=tuple(
            TopicAllocation(
                name=r.topic.name,
                share=float(r.cost * link.values[i]),
                max_rate_hz=r.max_rate_hz,
                rate_hz=math.inf if r.ceiling is None else float(link.values[i]),
                depth=float(memory.values[i]),
                deadline_ns=periods[i],
                depth_applied=depths[i],
                binding=link.bindings[i],
                depth_binding=memory.bindings[i],
            )
            for i, r in enumerate(rows)
        ),
        status=AllocationStatus.DEGRADED if given_up else AllocationStatus.OPTIMAL,
        binding=_overall(link, memory),
        capacity_bytes_per_second=level,
        degradation=given_up,
        backend=link.backend if memory.backend is link.backend else Backend.EXACT,
    )


def _paused(topics: Sequence[Topic]) -> Allocation:
    """Answer for a link that carries nothing: every topic waits, none loses its depth floor."""
    for topic in topics:
        refuse_nonsense(topic)
    return Allocation(
        topics=tuple(
            TopicAllocation(
                name=topic.name,
                share=0.0,
                max_rate_hz=0.0,
                rate_hz=0.0,
                depth=float(topic.min_depth),
                deadline_ns=0,
                depth_applied=topic.min_depth,
                binding=Binding.LINK,
                depth_binding=Binding.FLOOR,
            )
            for topic in topics
        ),
        status=AllocationStatus.DEGRADED,
        binding=Binding.LINK,
        capacity_bytes_per_second=0.0,
        degradation="the link has no capacity: every topic is paused",
        backend=Backend.EXACT,
    )


def _empty(level: float) -> Allocation:
    return Allocation(
        topics=(),
        status=AllocationStatus.EMPTY,
        binding=Binding.NOTHING,
        capacity_bytes_per_second=level,
        backend=Backend.EXACT,
    )


def _overall(link: _Division, memory: _Division) -> Binding:
    """Return the constraint to relax first: the link if any topic lacks rate, then memory, then the wishes."""
    if {Binding.LINK, Binding.FLOOR} & set(link.bindings):
        return Binding.LINK
    if Binding.MEMORY in memory.bindings or memory.given_up:
        return Binding.MEMORY
    return Binding.DESIRED_RATE if Binding.DESIRED_RATE in link.bindings else Binding.NOTHING


def _weights(rows: Sequence[Row]) -> tuple[float, ...]:
    return tuple(r.topic.weight for r in rows)


def _left(part: Fraction) -> str:
    return f"cut to {float(part):.0%}" if part else "given up"
