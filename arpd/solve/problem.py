"""The one problem every back end solves, and the one typed outcome each of them returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.model.settings import Backend

#: Shares are fractions of the whole link, so one absolute tolerance fits every topic (docs/design.md, The program).
TOLERANCE = 1e-6
#: A topic that needs 1e-5 of the link would hide a 10 % error below ``TOLERANCE``; this one it cannot hide.
RELATIVE_TOLERANCE = 1e-3
#: Shares too small for the relative tolerance to mean anything.
_NOISE = 1e-12


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareProblem:
    """Divide one budget over weighted, bounded shares: (G1) of the link, (G2) of memory (docs/design.md, The program).

    ``min Σ e_i²/(2 w_i) − κ Σ e_i  s.t.  Σ e_i ≤ B, lo_i ≤ e_i ≤ hi_i`` with κ ≥ max hi_i / w_i, so that no share
    stops growing for any reason but a constraint. Its solution is e_i = clip(ν·w_i, lo_i, hi_i): weighted
    proportional-fair and weighted max-min at once.

    Every number is whole, in units that the caller chose so that no digit is lost; a back end that works in floats
    divides by ``whole``.

    Parameters
    ----------
    weights : w_i > 0, in any common unit
    lo, hi : bounds of the shares, 0 ≤ lo_i ≤ hi_i (1/whole)
    budget : B > 0 (1/whole)
    whole : what a share of 1 is, > 0
    """

    weights: tuple[int, ...]
    lo: tuple[int, ...]
    hi: tuple[int, ...]
    budget: int
    whole: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Solved:
    """A vector of shares whose residuals were checked by us, not only by the library that returned it."""

    kind: ClassVar[str] = "solved"
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Infeasible:
    """No vector can satisfy the constraints; found analytically, never from a solver's status."""

    kind: ClassVar[str] = "infeasible"
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class SolverFailed:
    """The back end has no usable answer: a status other than solved, or residuals that do not hold."""

    kind: ClassVar[str] = "failed"
    reason: str


Outcome = Solved | Infeasible | SolverFailed


class Solver(Protocol):
    """A back end; ``name`` is its name in settings, metrics and ``Allocation.backend``."""

    name: Backend

    def solve(self, problem: ShareProblem) -> Outcome:
        """Solve ``problem``; a library's exception comes back as ``SolverFailed``."""
        ...


def infeasibility(problem: ShareProblem) -> Infeasible | None:
    """Return why ``problem`` has no solution, None when it has one: the floors alone decide."""
    floors = sum(problem.lo)
    if floors > problem.budget:
        needed, budget = floors / problem.whole, problem.budget / problem.whole
        return Infeasible(reason=f"floors need {needed:.6g} of a budget of {budget:.6g}")
    return None


def checked(problem: ShareProblem, values: Sequence[float], *, solver: str, parts: int = 10) -> Outcome:
    """Turn a library's vector into an outcome: ``Solved`` only if it is feasible and optimal.

    Parameters
    ----------
    solver : whose vector it is, for the reason of a failure
    parts : what the tolerances are divided by: small misses of many shares add up
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
    """Largest violation of any constraint (share)."""
    return max(
        math.fsum(values) - problem.budget / problem.whole,
        *(lo / problem.whole - value for lo, value in zip(problem.lo, values, strict=True)),
        *(value - hi / problem.whole for hi, value in zip(problem.hi, values, strict=True)),
        0.0,
    )


def at_level(problem: ShareProblem, values: Sequence[float]) -> list[float]:
    """Return clip(ν·w_i, lo_i, hi_i) at the level ν these shares stand at: of an optimum, the shares themselves.

    ν is taken from the share that is farthest from both its bounds: on that one the solver's noise tells least. Where
    all stand on bounds, the highest of those at their ceilings will do.
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
    """Whether two answers differ by more than the tolerances, absolute or relative, in any share.

    Parameters
    ----------
    parts : what the tolerances are divided by
    """
    return any(
        parts * abs(value - truth) > min(TOLERANCE, RELATIVE_TOLERANCE * max(truth, _NOISE))
        for value, truth in zip(values, reference, strict=True)
    )
