"""The DEPTH/DEADLINE program, topic by topic: (G1) divides the link, (G2) divides the memory.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from arpd.model.allocation import Allocation, AllocationStatus, Binding, TopicAllocation
from arpd.model.price import Price
from arpd.model.settings import Backend, Policy
from arpd.solve.checked import CheckedSolver, load
from arpd.solve.exact import ActiveBound
from arpd.solve.problem import ShareProblem
from arpd.solve.rows import SAMPLE, Ratio, Row, decimal, give_up, period_ns, rate_of, refuse_nonsense, rows_of, whole
from arpd.solve.uniform import divide_evenly

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from arpd.model.allocation import Topic
    from arpd.model.settings import ProgramSettings, Settings

_REMEMBERED = 4  # answers: those of the last ticks, and the lasting one


@dataclass(frozen=True, kw_only=True, slots=True)
class _Division:
    """Division of one budget.

    Parameters
    ----------
    values : share of the link (1/units.share) or depth (samples) per row
    bindings : what stops each value
    backend : back end that answered
    given_up : what was given up, in words
    level : ν, the common level per weight; 0 where nothing is left to divide after the floors
    yielding : the heaviest weight whose floor was cut, and the part of it that is kept
    """

    values: list[Ratio]
    bindings: list[Binding]
    backend: Backend
    given_up: tuple[str, ...] = ()
    level: float = 0.0
    yielding: tuple[float, float] = (0.0, 1.0)


class Program:
    """Solves (G1), then (G2) on its result, and rounds to what publishers can run.

    (G1) divides link time: e_i = a_i·R_i = clip(ν·w_i, a_i·ℓ_i, a_i·u_i) with Σ e_i ≤ B = η − Σ a_i·ρ_i.
    (G2) divides memory: g_i = m_i·D_i/M, Σ g_i ≤ 1, Dmin_i ≤ D_i ≤ min(Dmax_i, τ_i·R_i − δ_i).

    With identical topics, η = 1, ρ = Rmin, no latency budget and ample memory this is Eq. (4) of the paper.

    All numbers are whole (``rows.Units``), so binary noise loses nothing before the last step. That step is safe:
    ⌈1e9/R⌉ can only lower a rate, ⌊D⌋ can only lower a depth, and both budgets are sums.

    Analysis decides infeasibility before any solver runs. The program then gives up, in this order and by no more than
    it must, so no rate rises while the capacity falls:

    1. δ: where τ_i·R_i − δ_i is below Dmin_i, the depth is Dmin_i. Every slow topic on a fast link meets this and loses
       nothing: ``depth_binding`` is FLOOR, and the answer is not degraded.
    2. ρ, the rate reserve.
    3. The floors ℓ_i, class by class in ascending weight, down to 0 (paused); for memory, Dmin_i down to 1.

    Σ e_i never exceeds η.

    Parameters
    ----------
    settings : policy and back end
    headroom : η, the share of the capacity that may be planned, 0..1
    packet_overhead_s : t_ovh, link time of a packet beyond its bytes (s)
    backend : back end for this program alone; None = the one in ``settings``
    rate_reserve : ρ_i as a multiple of ℓ_i; the paper's is 1, the daemon's 0 because η reserves already
    depth_reserve : δ_i as a multiple of Dmin_i; the paper's is 1
    deep : give depths for u_i, the most that a moving price may reach, and not for the rate of this division; a depth
        for the present rate loses samples when the rate rises
    clock : monotonic clock for ``Allocation.solve_s``, which stays 0 without one (s)
    """

    def __init__(
        self,
        *,
        settings: ProgramSettings,
        headroom: float,
        packet_overhead_s: float = 0.0,
        backend: Backend | None = None,
        rate_reserve: int = 0,
        depth_reserve: int = 1,
        deep: bool = False,
        clock: Callable[[], float] = lambda: 0.0,
    ) -> None:
        if not 0.0 < headroom <= 1.0:
            raise ValueError(f"headroom {headroom!r} must be above 0 and at most 1")
        for name, value in (
            ("packet_overhead_s", packet_overhead_s),
            ("rate_reserve", rate_reserve),
            ("depth_reserve", depth_reserve),
        ):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} {value!r} must be a number of at least 0")
        #: Whether all topics get one rate and one depth.
        self.is_uniform = settings.policy is Policy.UNIFORM
        self._headroom = headroom
        self._deep = deep
        self._packet_overhead_s = packet_overhead_s
        self._rate_reserve = rate_reserve
        self._depth_reserve = depth_reserve
        self._solver = CheckedSolver(load(backend or settings.backend))
        self._clock = clock
        self._last: dict[tuple[float, tuple[Topic, ...], float, float, float, int], Allocation] = {}

    @classmethod
    def of(
        cls, settings: Settings, *, backend: Backend | None = None, clock: Callable[[], float] = lambda: 0.0
    ) -> Program:
        """Return the program of a configuration, live or offline."""
        return cls(
            settings=settings.program,
            headroom=settings.link.headroom,
            packet_overhead_s=settings.link.packet_overhead_s or 0.0,
            backend=backend,
            deep=True,
            clock=clock,
        )

    @property
    def outcomes(self) -> Mapping[tuple[str, str], int]:
        """Copy of the counts (back end, ``solved`` | ``infeasible`` | ``failed``) since this program was made."""
        return self._solver.outcomes

    @property
    def disagreements(self) -> int:
        """Number of answers that ``exact`` contradicted since this program was made."""
        return self._solver.disagreements

    def solve(
        self,
        capacity_bytes_per_second: float,
        topics: Sequence[Topic],
        memory_budget_bytes: float,
        *,
        packet_overhead_s: float | None = None,
        share: float | None = None,
        crossing: int = 0,
    ) -> Allocation:
        """Divide the link and the memory among ``topics``.

        ``deadline_ns`` of the answer is the bare period ⌈1e9/R⌉, without the slack of a plan. A topic that gets no rate
        is paused: rate 0, ``deadline_ns`` 0, depth at its floor.

        Parameters
        ----------
        capacity_bytes_per_second : C, after cross traffic and before headroom, ≥ 0 (bytes/s)
        topics : rows of the program
        memory_budget_bytes : M, memory that all histories may take, ≥ 0 (bytes)
        packet_overhead_s : measured t_ovh, ≥ 0; None = that of this program (s)
        share : part of the capacity to divide, 0..1; None = the headroom of this program
        crossing : topics that cross the link, managed or not; only the uniform policy needs it
        """
        overhead_s = self._packet_overhead_s if packet_overhead_s is None else packet_overhead_s
        share = self._headroom if share is None else share
        question = (capacity_bytes_per_second, tuple(topics), memory_budget_bytes, overhead_s, share, crossing)
        if (known := self._last.pop(question, None)) is not None:
            self._last[question] = known  # the newest again: the lasting budget changes less often than that of a tick
            return known  # most ticks bring nothing new, and exact arithmetic is most of their cost
        started = self._clock()
        for name, value in (
            ("capacity", capacity_bytes_per_second),
            ("memory budget", memory_budget_bytes),
            ("packet overhead", overhead_s),
            ("share", share),
        ):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} {value!r} must be a number of at least 0")
        if share > 1.0:
            raise ValueError(f"share {share!r} must be at most 1")
        divide = partial(divide_evenly, crossing=crossing, solver=self._solver) if self.is_uniform else self._allocate
        if topics:
            memory_budget = decimal(memory_budget_bytes)
            allocation = divide(capacity_bytes_per_second, topics, memory_budget, decimal(overhead_s), decimal(share))
        else:
            allocation = _empty(capacity_bytes_per_second * share)
        allocation = replace(allocation, solve_s=self._clock() - started)
        self._last = dict([*self._last.items()][1 - _REMEMBERED :])
        self._last[question] = allocation
        return allocation

    def _allocate(
        self, capacity: float, topics: Sequence[Topic], memory_budget: Ratio, packet_overhead: Ratio, share: Ratio
    ) -> Allocation:
        if not capacity:
            self._solver.note_infeasible()
            return _paused(topics)
        rows = rows_of(topics, capacity=decimal(capacity), packet_overhead=packet_overhead, parts=share[1])
        link = self._divide_link(rows, share)
        memory = self._divide_memory(rows, link, memory_budget)
        price = Price(
            share_per_weight=link.level,
            capacity_bytes_per_second=capacity,
            packet_overhead_s=packet_overhead[0] / packet_overhead[1],
            yielding_weight=link.yielding[0],
            kept_floor=link.yielding[1],
        )
        level = capacity * (share[0] / share[1])
        return replace(self._published(rows, link, memory, level), price=price)

    def _divide_link(self, rows: list[Row], part: Ratio) -> _Division:
        """Solve (G1): a share of the link per row."""
        whole_link = rows[0].units.share
        usable = whole_link * part[0] // part[1]  # exact in these units
        needed = sum(r.lo for r in rows)
        reserve = self._rate_reserve * needed
        if needed + reserve > usable:
            self._solver.note_infeasible()
            return _cut_rates(rows, needed=needed, reserve=reserve, usable=usable)
        problem = ShareProblem(
            weights=tuple(r.weight for r in rows),
            lo=tuple(r.lo for r in rows),
            hi=tuple(r.hi for r in rows),
            budget=usable - reserve,
            whole=whole_link,
        )
        fill, backend = self._solver.solve(problem)
        bindings = [
            r.ceiling
            if bound is ActiveBound.HIGH or r.lo == r.hi
            else (Binding.FLOOR if bound is ActiveBound.LOW and r.lo else Binding.LINK)
            for r, bound in zip(rows, fill.bounds, strict=True)
        ]
        level = fill.level_per_weight * rows[0].units.weight
        return _Division(values=fill.ratios(), bindings=bindings, backend=backend, level=level)

    def _divide_memory(self, rows: list[Row], link: _Division, memory_budget: Ratio) -> _Division:
        """Solve (G2): a depth per row, given the rates."""
        (*slots, budget), _ = whole([*(decimal(r.topic.slot_bytes) for r in rows), memory_budget])
        needed = sum(slot * r.topic.min_depth for slot, r in zip(slots, rows, strict=True))
        if needed > budget:
            self._solver.note_infeasible()
            return _cut_depths(rows, slots, needed=needed, budget=budget)
        justified = [
            r.justified(r.wish_hz if self._deep else r.rate_hz(share), reserve=self._depth_reserve)
            for r, share in zip(rows, link.values, strict=True)
        ]
        caps = [r.depth_cap(history) for r, history in zip(rows, justified, strict=True)]
        problem = ShareProblem(
            weights=tuple(r.weight for r in rows),
            lo=tuple(slot * r.topic.min_depth * SAMPLE for slot, r in zip(slots, rows, strict=True)),
            hi=tuple(slot * cap for slot, cap in zip(slots, caps, strict=True)),
            budget=budget * SAMPLE,
            whole=max(1, budget * SAMPLE),
        )
        fill, backend = self._solver.solve(problem)
        values: list[Ratio] = []
        bindings: list[Binding] = []
        for i, (r, (taken, parts), bound) in enumerate(zip(rows, fill.ratios(), fill.bounds, strict=True)):
            if bound is ActiveBound.HIGH or problem.lo[i] == problem.hi[i]:
                values.append((caps[i], SAMPLE))
                bindings.append(r.depth_binding(justified[i]))
            else:
                values.append((taken, parts * slots[i] * SAMPLE))
                bindings.append(Binding.FLOOR if bound is ActiveBound.LOW else Binding.MEMORY)
        return _Division(values=values, bindings=bindings, backend=backend)

    def _published(self, rows: list[Row], link: _Division, memory: _Division, level: float) -> Allocation:
        """Round both divisions to whole nanoseconds and samples, and join them in one answer.

        The depth is rounded down last, from the rate of the whole period, so (3) holds by construction.
        """
        topics = []
        for i, r in enumerate(rows):
            share, (depth, depth_parts) = link.values[i], memory.values[i]
            rate_hz = r.rate_hz(share)
            period = period_ns(rate_hz)
            history = rate_of(period_ns(r.wish_hz) if self._deep else period)
            cap = r.depth_cap(r.justified(history, reserve=self._depth_reserve))
            topics.append(
                TopicAllocation(
                    name=r.topic.name,
                    share=share[0] / (share[1] * r.units.share),
                    max_rate_hz=r.max_rate_hz,
                    rate_hz=rate_hz[0] / rate_hz[1],
                    depth=depth / depth_parts,
                    deadline_ns=period,
                    depth_applied=min(depth // depth_parts, cap // SAMPLE),
                    binding=link.bindings[i],
                    depth_binding=memory.bindings[i],
                )
            )
        given_up = "; ".join(link.given_up + memory.given_up)
        return Allocation(
            topics=tuple(topics),
            status=AllocationStatus.DEGRADED if given_up else AllocationStatus.OPTIMAL,
            binding=_overall(link, memory),
            capacity_bytes_per_second=level,
            degradation=given_up,
            backend=link.backend if memory.backend is link.backend else Backend.EXACT,
        )


def _cut_rates(rows: list[Row], *, needed: int, reserve: int, usable: int) -> _Division:
    """Give up the rate reserve, then floors; the link carries only what remains of the floors."""
    left = give_up([r.lo for r in rows], [r.weight for r in rows], needed - usable)
    notes = [f"rate reserve {_left((max(0, usable - needed), reserve))}"] if reserve else []
    notes += [f"rate floor of weight {w / rows[0].units.weight:g} {_left(part)}" for w, part in left.items()]
    heaviest, part = max(left.items(), default=(0, (1, 1)))
    values: list[Ratio] = []
    bindings: list[Binding] = []
    for r in rows:
        kept, parts = left.get(r.weight, (1, 1))
        values.append((r.lo * kept, parts))
        if kept < parts or not r.lo:
            bindings.append(Binding.LINK)
        else:
            bindings.append(r.ceiling if r.lo == r.hi else Binding.FLOOR)
    return _Division(
        values=values,
        bindings=bindings,
        backend=Backend.EXACT,
        given_up=tuple(notes),
        yielding=(heaviest / rows[0].units.weight, part[0] / part[1]),
    )


def _cut_depths(rows: list[Row], slots: list[int], *, needed: int, budget: int) -> _Division:
    """Give up depth floors down to one sample, the least that a history can hold."""
    spare = [slot * (r.topic.min_depth - 1) for slot, r in zip(slots, rows, strict=True)]
    left = give_up(spare, [r.weight for r in rows], needed - budget)
    notes = [f"depth floor of weight {w / rows[0].units.weight:g} {_left(part)}" for w, part in left.items()]
    if sum(slots) > budget:
        notes.append("memory budget below one sample per topic")
    values: list[Ratio] = []
    for r in rows:
        kept, parts = left.get(r.weight, (1, 1))
        values.append((parts + (r.topic.min_depth - 1) * kept, parts))
    return _Division(
        values=values,
        bindings=[Binding.MEMORY if r.weight in left else Binding.FLOOR for r in rows],
        backend=Backend.EXACT,
        given_up=tuple(notes),
    )


def _paused(topics: Sequence[Topic]) -> Allocation:
    """Answer for a link that carries nothing: every topic pauses and keeps its depth floor."""
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
        price=Price(
            share_per_weight=0.0,
            capacity_bytes_per_second=1.0,
            yielding_weight=max(topic.weight for topic in topics),
            kept_floor=0.0,
        ),
        backend=Backend.EXACT,
    )


def _empty(level: float) -> Allocation:
    return Allocation(
        topics=(), status=AllocationStatus.EMPTY, binding=Binding.NOTHING, capacity_bytes_per_second=level
    )


def _overall(link: _Division, memory: _Division) -> Binding:
    """Return the constraint to relax first: the link if any topic lacks rate, then memory, then desired rates."""
    if {Binding.LINK, Binding.FLOOR} & set(link.bindings):
        return Binding.LINK
    if Binding.MEMORY in memory.bindings or memory.given_up:
        return Binding.MEMORY
    return Binding.DESIRED_RATE


def _left(part: Ratio) -> str:
    return f"cut to {part[0] / part[1]:.0%}" if part[0] else "given up"
