"""The DEPTH/DEADLINE program: (G1) divides the link, (G2) divides the memory, or Eq. (4) gives all topics the same.

Design: docs/design.md, The program.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from arpd.model.allocation import Allocation, AllocationStatus, Binding, Topic, TopicAllocation
from arpd.model.settings import Backend, Policy, Settings
from arpd.solve.backends import Solver
from arpd.solve.eq4 import AlikeOnLink, period_ns, whole
from arpd.solve.level import Column, water_level
from arpd.solve.link import Division, Find, Link, Rows

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable, Sequence


class Program:
    """Solves (G1), then (G2), and rounds to what publishers can run; with ``policy: uniform`` Eq. (4) instead.

    (G1) divides link time: e_i = a_i·R_i = clip(ν·w_i, a_i·ℓ_i, a_i·u_i) with Σ e_i = B.
    (G2) divides memory: Σ m_i·D_i ≤ M, Dmin_i ≤ D_i ≤ min(Dmax_i, τ_i·u_i − δ_i). A history is made for u_i, the most
    that a moving price may reach: one for the rate of this moment would lose samples when the rate rises.

    Analysis decides infeasibility before any solver runs. The program then gives up, in this order and by no more than
    it must, so no rate rises while the capacity falls:

    1. δ: where τ_i·u_i − δ_i is below Dmin_i, the depth is Dmin_i. Every slow topic on a fast link meets this and loses
       nothing: ``depth_binding`` is MINIMUM, and the answer is not degraded.
    2. The floors ℓ_i, class by class in ascending weight, down to 0 (paused); for memory, Dmin_i down to 1.

    Parameters
    ----------
    settings : policy and back end; headroom η and packet overhead t_ovh where nothing measured stands for them
    backend : back end for this program alone; None = the one in ``settings``
    clock : monotonic clock for ``Allocation.solve_s``, which stays 0 without one (s)
    outcomes, load : see `Solver`
    """

    def __init__(
        self,
        settings: Settings,
        *,
        backend: Backend | None = None,
        clock: Callable[[], float] = lambda: 0.0,
        outcomes: Counter[tuple[str, str]] | None = None,
        load: Callable[[str], Any] | None = None,
    ) -> None:
        self._settings = settings
        self._solver = Solver(backend or settings.program.backend, outcomes, load=load)
        self._clock = clock
        self._rows = Rows(())

    @property
    def outcomes(self) -> Counter[tuple[str, str]]:
        """Counts by back end and outcome; see `Solver`."""
        return self._solver.outcomes

    def on_link(
        self,
        capacity_bytes_per_second: float,
        topics: Sequence[Topic],
        *,
        packet_overhead_s: float | None = None,
        share: float | None = None,
        crossing: int = 0,
    ) -> Link:
        """Return the rows on a link, with the price of the closed form.

        Parameters
        ----------
        capacity_bytes_per_second : C, after cross traffic and before headroom, ≥ 0 (bytes/s)
        topics : rows of the program
        packet_overhead_s : measured t_ovh, ≥ 0; None = as configured (s)
        share : part of the capacity to divide, 0..1; None = the headroom
        crossing : topics that cross the link, managed or not; only the uniform policy needs it
        """
        capacity, configured = capacity_bytes_per_second, self._settings.link
        overhead_s = configured.packet_overhead_s or 0.0 if packet_overhead_s is None else packet_overhead_s
        share = configured.headroom if share is None else share
        if topics is not self._rows.topics:
            self._rows = Rows(topics)
        if topics and self._settings.program.policy is Policy.UNIFORM:
            return AlikeOnLink(self._rows, capacity, overhead_s, share, crossing=crossing)
        return Link(self._rows, capacity, overhead_s, share)

    def solve(self, link: Link, memory_bytes: float) -> Allocation:
        """Divide the link and the memory that all histories may take among the rows, by the back end.

        ``deadline_ns`` of the answer is the bare period ⌈1e9/R⌉, without the slack of a plan. A topic that gets no rate
        is paused: rate 0, ``deadline_ns`` 0.
        """
        started_s, answered = self._clock(), set[Backend]()

        def find(weights: Column, low: Column, high: Column, budget: float) -> float:
            level, backend = self._solver.level(weights, low, high, budget)
            answered.update([backend] if backend else ())
            return level

        found = _divided(link, memory_bytes, find)
        backend = answered.pop() if len(answered) == 1 else Backend.CLOSED_FORM
        return replace(found, backend=backend, solve_s=self._clock() - started_s)

    def follow(self, lasting: Allocation, link: Link, memory_bytes: float) -> Allocation:
        """Divide the link of this moment by the closed form; `solve` gave what lasts."""
        found = _divided(link, memory_bytes, water_level)
        return replace(found, backend=lasting.backend, solve_s=lasting.solve_s)


def _divided(link: Link, memory_bytes: float, find: Find) -> Allocation:
    if not link.rows.topics:
        return Allocation(budget_bytes_per_second=link.capacity * link.share)
    division = link.divide(memory_bytes, find)
    rows = _published(link, division)
    return Allocation(
        topics=rows,
        status=AllocationStatus.DEGRADED if division.given_up else AllocationStatus.OPTIMAL,
        binding=_overall(rows),
        budget_bytes_per_second=link.capacity * link.share,
        degradation="; ".join(division.given_up),
        price=division.price,
        uniform=division.uniform,
    )


def _published(link: Link, division: Division) -> tuple[TopicAllocation, ...]:
    """Round to whole nanoseconds and samples; a paused topic has the rate 0."""
    columns = (division.rates_hz * link.costs_s, division.rates_hz, 1.0 / link.costs_s, division.depths)
    return tuple(
        TopicAllocation(
            name=topic.name,
            share=share,
            max_rate_hz=alone_hz if link.capacity else 0.0,
            rate_hz=rate_hz,
            depth=depth,
            deadline_ns=period_ns(rate_hz),
            depth_applied=whole(depth),
            binding=binding,
            depth_binding=depth_binding,
        )
        for topic, share, rate_hz, alone_hz, depth, binding, depth_binding in zip(
            link.rows.topics,
            *(column.tolist() for column in columns),
            link.bindings(division.rates_hz),
            division.depth_bindings,
            strict=True,
        )
    )


def _overall(topics: Sequence[TopicAllocation]) -> Binding:
    """Return the constraint to relax first: the link if any topic lacks rate, then memory, then desired rates."""
    if any(topic.binding is not Binding.DESIRED_RATE for topic in topics):
        return Binding.LINK
    return Binding.MEMORY if any(t.depth_binding is Binding.MEMORY for t in topics) else Binding.DESIRED_RATE
