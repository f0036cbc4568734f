"""Problem that every back end solves, and the typed outcome that each returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.settings import Backend

#: Shares are fractions of the whole link, so one absolute tolerance fits every topic (docs/design.md, The program).
TOLERANCE = 1e-6
#: A topic that needs 1e-5 of the link would hide a 10 % error below ``TOLERANCE``, but not below this one.
RELATIVE_TOLERANCE = 1e-3
#: Shares too small for the relative tolerance to mean anything.
_NOISE = 1e-12


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareProblem:
    """Division of a budget into weighted, bounded shares: (G1) and (G2) (docs/design.md, The program).

    ``min Σ e_i²/(2 w_i) − κ Σ e_i  s.t.  Σ e_i ≤ B, lo_i ≤ e_i ≤ hi_i`` with κ ≥ max hi_i / w_i, so only a constraint
    stops a share from growing. Its solution is e_i = clip(ν·w_i, lo_i, hi_i): weighted proportional-fair and weighted
    max-min at once.

    Every number is whole, in units of the caller that lose no digit; a back end that works in floats divides by
    ``whole``.

    Parameters
    ----------
    weights : w_i > 0, in any common unit
    lo, hi : bounds of the shares, 0 ≤ lo_i ≤ hi_i (1/whole)
    budget : B > 0 (1/whole)
    whole : units in a share of 1, > 0
    """

    weights: tuple[int, ...]
    lo: tuple[int, ...]
    hi: tuple[int, ...]
    budget: int
    whole: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Solved:
    """Vector of shares whose residuals arpd checked, not only the library that returned it."""

    kind: ClassVar[str] = "solved"
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Infeasible:
    """Constraints that no vector can satisfy, by analysis and never by the status of a solver."""

    kind: ClassVar[str] = "infeasible"
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class SolverFailed:
    """Back end without a usable answer: a status other than solved, or residuals that do not hold."""

    kind: ClassVar[str] = "failed"
    reason: str


Outcome = Solved | Infeasible | SolverFailed


class Solver(Protocol):
    """Back end; ``name`` is its name in settings, metrics and ``Allocation.backend``."""

    name: Backend

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem``; a library's exception comes back as ``SolverFailed``."""
        ...


def infeasibility(problem: ShareProblem) -> Infeasible | None:
    """Return why ``problem`` has no solution, None when it has one; only the floors decide."""
    floors = sum(problem.lo)
    if floors > problem.budget:
        needed, budget = floors / problem.whole, problem.budget / problem.whole
        return Infeasible(reason=f"floors need {needed:.6g} of a budget of {budget:.6g}")
    return None


def checked(problem: ShareProblem, values: Sequence[float], *, solver: str, parts: int = 10) -> Outcome:
    """Return the outcome of a library's vector: ``Solved`` only if it is feasible and optimal.

    Parameters
    ----------
    solver : name of the library, for the reason of a failure
    parts : divisor of the tolerances, because small misses of many shares add up
    """
    if len(values) != len(problem.lo) or any(math.isnan(value) for value in values):
        return SolverFailed(reason=f"{solver}: not one number per topic")
    if (violation := infeasible_by(problem, values)) > TOLERANCE / parts:
        return SolverFailed(reason=f"{solver}: constraints are violated by {violation:.3g}")
    if disagreement(values, at_level(problem, values), parts=parts):
        return SolverFailed(reason=f"{solver}: the shares are not at one level")
    if (unspent := min(problem.budget, sum(problem.hi)) / problem.whole - math.fsum(values)) > TOLERANCE / parts:
        return SolverFailed(reason=f"{solver}: {unspent:.3g} of the budget is not handed out")
    return Solved(values=tuple(values))


def infeasible_by(problem: ShareProblem, values: Sequence[float]) -> float:
    """Return the largest violation of any constraint (share)."""
    return max(
        math.fsum(values) - problem.budget / problem.whole,
        *(lo / problem.whole - value for lo, value in zip(problem.lo, values, strict=True)),
        *(value - hi / problem.whole for hi, value in zip(problem.hi, values, strict=True)),
        0.0,
    )


def at_level(problem: ShareProblem, values: Sequence[float]) -> list[float]:
    """Return clip(ν·w_i, lo_i, hi_i) at the level ν of these shares; for an optimum these are the shares themselves.

    The share farthest from both its bounds gives ν, because the solver's noise matters least there. Where all are at
    bounds, the highest one at its ceiling gives ν.
    """
    whole, heaviest = problem.whole, max(problem.weights)
    rows = [
        (weight / heaviest, low / whole, high / whole)
        for weight, low, high in zip(problem.weights, problem.lo, problem.hi, strict=True)
    ]
    inside, level = max(
        (min(value - low, high - value), value / weight)
        for value, (weight, low, high) in zip(values, rows, strict=True)
    )
    if inside <= 0.0:
        free = zip(values, rows, strict=True)
        at_ceilings = (high / weight for value, (weight, low, high) in free if low < high <= value)
        level = max(at_ceilings, default=0.0)
    return [min(max(level * weight, low), high) for weight, low, high in rows]


def disagreement(values: Sequence[float], reference: Sequence[float], *, parts: int = 1) -> bool:
    """Return whether two answers differ in any share by more than the tolerances, which ``parts`` divides."""
    return any(
        parts * abs(value - truth) > min(TOLERANCE, RELATIVE_TOLERANCE * max(truth, _NOISE))
        for value, truth in zip(values, reference, strict=True)
    )
