"""The one problem every back end solves, and the one typed outcome each of them returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from arpd.settings import Backend

#: Shares are fractions of the whole link, so one absolute tolerance fits every topic (DESIGN §4).
TOLERANCE = 1e-6
#: A topic that needs 1e-5 of the link would hide a 10 % error below ``TOLERANCE``; this one it cannot hide.
RELATIVE_TOLERANCE = 1e-3
#: Shares too small for the relative tolerance to mean anything.
_NOISE = 1e-12


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareProblem:
    """Divide one budget over weighted, bounded shares: (G1) of the link, (G2) of memory (DESIGN §4).

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


def checked(problem: ShareProblem, values: Sequence[float], *, solver: str) -> Outcome:
    """Turn a library's vector into an outcome: ``Solved`` only if every constraint holds to ``TOLERANCE``."""
    violation = residual(problem, values)
    if not violation <= TOLERANCE:  # also catches nan
        return SolverFailed(reason=f"{solver}: constraints are violated by {violation:.3g}")
    return Solved(values=tuple(values))


def residual(problem: ShareProblem, values: Sequence[float]) -> float:
    """Largest violation of any constraint (share); nan when there is not one number per topic."""
    if len(values) != len(problem.lo) or any(math.isnan(value) for value in values):
        return math.nan
    return max(
        math.fsum(values) - problem.budget / problem.whole,
        *(lo / problem.whole - value for lo, value in zip(problem.lo, values, strict=True)),
        *(value - hi / problem.whole for hi, value in zip(problem.hi, values, strict=True)),
        0.0,
    )


def disagreement(values: Sequence[float], reference: Sequence[float]) -> bool:
    """Whether two answers differ by more than the tolerances, absolute or relative, in any share."""
    return any(
        abs(value - truth) > min(TOLERANCE, RELATIVE_TOLERANCE * max(truth, _NOISE))
        for value, truth in zip(values, reference, strict=True)
    )
