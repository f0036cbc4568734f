"""The uniform policy: Eq. (4) of the paper on the live link, with one rate and one depth for all topics.

Design: docs/design.md, The program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from arpd.model.allocation import Allocation, AllocationStatus, Binding, TopicAllocation, Uniform
from arpd.model.price import Price
from arpd.model.settings import Backend
from arpd.solve.eq4 import Eq4Problem
from arpd.solve.rows import decimal, period_ns, rate_of, rational, rows_of, whole

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.allocation import Topic
    from arpd.model.plan import TopicPlan
    from arpd.solve.checked import CheckedSolver
    from arpd.solve.rows import Ratio, Row

# Terms of every row of a uniform plan. Equal terms give every publisher the same rate. They never change, so the price
# alone moves the rate, also when a topic comes or a message grows, and no plan is needed for that.
_WEIGHT, _WIRE_BYTES, _PACKETS = 1.0, 1000.0, 0
_LEAST_RMIN_HZ = 1e-6  # Eq. (4) needs Rmin > 0, but ``min_rate_hz`` may be 0


@dataclass(frozen=True, kw_only=True, slots=True)
class _Optimum:
    """R and D for all topics.

    Parameters
    ----------
    rate_hz, depth : the real R and D (Hz, samples)
    depth_applied : D for the rate of the whole period (samples)
    binding, depth_binding : what stops R, and what stops D
    given_up : what was given up, in words
    kept_floor : part of Rmin that R keeps, 0..1
    backend : back end that answered
    """

    rate_hz: Fraction
    depth: Fraction
    depth_applied: int
    binding: Binding
    depth_binding: Binding
    given_up: tuple[str, ...] = ()
    kept_floor: float = 1.0
    backend: Backend = Backend.EXACT


def divide_evenly(
    capacity: float,
    topics: Sequence[Topic],
    memory_budget: Ratio,
    packet_overhead: Ratio,
    share: Ratio,
    *,
    crossing: int,
    solver: CheckedSolver,
) -> Allocation:
    """Give all topics one rate R and one depth D, the optimum of Eq. (4).

    Rmax is the rate at which one topic alone fills the divided part of the link: 1 over the mean link time of a message
    of these topics. Rmin, Dmin and Dmax are those of the topics, and N counts every topic that crosses the link.

    Where (2) cannot be met, the rate reserve gives way, then Rmin, by no more than they must. So R never rises while
    the capacity falls, and N topics at R always fit. Where (3) cannot be met, D is Dmin; the answer is not degraded.
    Beyond the paper, a latency budget τ and the memory M limit D: D ≤ τ·R, and all histories together fit into M.

    A source that is slower than R keeps its own period. What it leaves goes to nobody, as in the paper.

    Parameters
    ----------
    capacity : C, after cross traffic and before headroom, ≥ 0 (bytes/s)
    topics : rows of the program, at least one
    memory_budget : M (bytes)
    packet_overhead : t_ovh (s)
    share : part of the capacity to divide
    crossing : topics that cross the link, managed or not
    solver : solves Eq. (4) and checks the answer
    """
    count = max(crossing, len(topics))
    rows = rows_of(topics, capacity=decimal(capacity or 1.0), packet_overhead=packet_overhead, parts=share[1])
    if capacity and share[0]:
        max_rate_hz = len(rows) * share[0] * rows[0].units.time / (share[1] * sum(row.cost for row in rows))
        optimum = _optimum(topics, solver, max_rate_hz=max_rate_hz, count=count, memory_budget=memory_budget)
    else:
        solver.note_infeasible()
        max_rate_hz, optimum = 0.0, _paused(topics)
    return Allocation(
        topics=tuple(_answer(row, optimum) for row in rows),
        status=AllocationStatus.DEGRADED if optimum.given_up else AllocationStatus.OPTIMAL,
        binding=_overall(rows, optimum),
        capacity_bytes_per_second=capacity * (share[0] / share[1]),
        degradation="; ".join(optimum.given_up),
        price=Price(
            share_per_weight=float(optimum.rate_hz) * _WIRE_BYTES / (_WEIGHT * (capacity or 1.0)),
            capacity_bytes_per_second=capacity or 1.0,
            yielding_weight=_WEIGHT if optimum.kept_floor < 1.0 else 0.0,
            kept_floor=optimum.kept_floor,
        ),
        uniform=Uniform(
            topics=count,
            max_rate_hz=max_rate_hz,
            rate_hz=float(optimum.rate_hz),
            depth=optimum.depth_applied,
        ),
        backend=optimum.backend,
    )


def alike(row: TopicPlan) -> TopicPlan:
    """Return a row of a uniform plan: its terms are those of every other row, so the price gives all one rate."""
    return replace(row, weight=_WEIGHT, wire_bytes=_WIRE_BYTES, packets=_PACKETS)


def _optimum(
    topics: Sequence[Topic], solver: CheckedSolver, *, max_rate_hz: float, count: int, memory_budget: Ratio
) -> _Optimum:
    min_depth = max(topic.min_depth for topic in topics)
    problem = Eq4Problem(
        max_rate_hz=max_rate_hz,
        topics=count,
        min_rate_hz=max(_LEAST_RMIN_HZ, *(topic.min_rate_hz for topic in topics)),
        min_depth=min_depth,
        max_depth=max(min_depth, *(topic.max_depth for topic in topics)),
    )
    backend = solver.solve_eq4(problem).backend
    even, floor = rational(max_rate_hz) / count, rational(problem.min_rate_hz)
    rate = min(even, max(floor, even - floor))  # where Eq. (4) has a solution, its vertex
    notes: list[str] = []
    if even < 2 * floor:
        notes.append(f"rate reserve {_left(max(Fraction(0), even - floor) / floor)}")
    if even < floor:
        notes.append(f"rate floor {_left(even / floor)}")
    (*slots, memory), _ = whole([*(decimal(topic.slot_bytes) for topic in topics), memory_budget])
    room = memory // sum(slots) if sum(slots) else problem.max_depth
    if room < min_depth:
        notes.append(f"depth floor cut to {room}" if room else "memory budget below one sample per topic")
    windows = [rational(topic.latency_budget_s) for topic in topics if topic.latency_budget_s is not None]
    window_s = min(windows, default=None)
    depth, depth_binding = _depth(problem, rate, window_s=window_s, room=room)
    rounded = Fraction(*rate_of(period_ns(rate.as_integer_ratio())))
    return _Optimum(
        rate_hz=rate,
        depth=depth,
        depth_applied=math.floor(_depth(problem, rounded, window_s=window_s, room=room)[0]),
        binding=Binding.FLOOR if rate == floor and even < 2 * floor else Binding.LINK,
        depth_binding=depth_binding,
        given_up=tuple(notes),
        kept_floor=min(1.0, float(rate / floor)),
        backend=backend,
    )


def _depth(problem: Eq4Problem, rate: Fraction, *, window_s: Fraction | None, room: int) -> tuple[Fraction, Binding]:
    """Return D at a rate, and what stops it.

    Parameters
    ----------
    window_s : τ, the longest time that a full history may stand for; None = any (s)
    room : depth at which the histories of all topics fill the memory (samples)
    """
    depth, binding = problem.depth_limit(rate), Binding.LINK
    if window_s is not None and window_s * rate < depth:
        depth, binding = window_s * rate, Binding.LATENCY_BUDGET
    if depth < problem.min_depth:
        depth, binding = Fraction(problem.min_depth), Binding.FLOOR
    return (Fraction(max(1, room)), Binding.MEMORY) if room < depth else (depth, binding)


def _paused(topics: Sequence[Topic]) -> _Optimum:
    """Return R and D of a link that carries nothing."""
    depth = max(topic.min_depth for topic in topics)
    return _Optimum(
        rate_hz=Fraction(0),
        depth=Fraction(depth),
        depth_applied=depth,
        binding=Binding.LINK,
        depth_binding=Binding.FLOOR,
        given_up=("the link has no capacity: every topic is paused",),
        kept_floor=0.0,
    )


def _answer(row: Row, optimum: _Optimum) -> TopicAllocation:
    """Return the answer for one topic; a source that is slower than R keeps its own period."""
    rate = min(optimum.rate_hz, _wish(row))
    return TopicAllocation(
        name=row.topic.name,
        share=float(rate * row.cost / row.units.time),
        max_rate_hz=row.max_rate_hz if optimum.rate_hz else 0.0,
        rate_hz=float(rate),
        depth=float(optimum.depth),
        deadline_ns=period_ns(rate.as_integer_ratio()),
        depth_applied=optimum.depth_applied,
        binding=optimum.binding if rate < _wish(row) else row.ceiling,
        depth_binding=optimum.depth_binding,
    )


def _wish(row: Row) -> Fraction:
    """Return the rate that the source wants, at most what the whole link carries of it (Hz)."""
    return Fraction(*row.rate_hz((row.hi, 1)))


def _overall(rows: Sequence[Row], optimum: _Optimum) -> Binding:
    """Return the constraint to relax first."""
    if any(optimum.rate_hz < _wish(row) for row in rows):
        return Binding.LINK
    return Binding.MEMORY if optimum.depth_binding is Binding.MEMORY else Binding.DESIRED_RATE


def _left(part: Fraction) -> str:
    return f"cut to {float(part):.0%}" if part else "given up"
